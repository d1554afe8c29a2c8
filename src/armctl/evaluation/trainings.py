"""Statistics of few trainings of one recipe, which say how another training would turn out.

All trainings play the same episodes, so that both are crossed. Two methods work together:

- Student's t, with the variance components of the analysis of variance (Searle, Casella and McCulloch, Variance
  Components, 1992, section 4.4). It takes trainings to vary normally.
- Random weights of trainings and of episodes, as in `armctl.evaluation.statistics.bounded_mean`, with one more training
  and one more episode at the bound. It takes nothing for granted, and with few trainings it is very wide.

The interval is Student's, extended by that of random weights of the episodes alone, which knows of rare disasters.
Where trainings vary so much that a normal distribution would lead beyond what is possible, as they do near 100 %
success, it is extended by random weights of both. By `benchmarks/intervals.py --table trainings`, it then holds as
often as it says. What it cannot know is a disaster that none of the trainings had: if one training in ten fails
altogether, three trainings show nothing of it in 73 % of cases. Only random weights of both would always hold, but from
three trainings that all succeed they conclude no more than a success rate above 29 %.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from armctl.evaluation.statistics import Bounds, Estimate, RandomWeights, bootstrapped, random_weights

Array = NDArray[np.float64]

FAR = 2.0
"""Standard deviations between trainings from the mean that still have to be possible for a normal distribution."""


@dataclass(frozen=True)
class TrainingMean:
    """A mean over several trainings of one recipe, which all played the same episodes."""

    mean: Estimate
    """Mean over all trainings and episodes; no interval for a single training."""
    trainings: int
    between: float | None
    """Standard deviation between trainings, without the part due to their episodes; None for a single one."""
    episodes: float | None
    """Standard deviation between episodes that is common to all trainings; None for a single one."""


@dataclass(frozen=True)
class CrossedDifference:
    """A mean of one learner minus that of another, at least one of which is several trainings."""

    estimate: Estimate
    narrow: Estimate
    """With the narrower interval, which lies within the margin of equivalent learners."""
    p: float
    """Two-sided p-value for no difference."""
    wide: Estimate | None = None
    """With the interval that holds at once for all pairs of a comparison; None in results of older versions."""


def mean_over_trainings(scores: Array, bounds: Bounds | None = None) -> TrainingMean:
    """Mean of scores (trainings, episodes), whose columns are the same episodes, for other trainings and episodes.

    `bounds` are the least and largest possible score. Without them, the interval is Student's alone, which does not
    hold near a bound.
    """
    scores = _table(scores)
    k = len(scores)
    value = float(scores.mean())
    if k < 2:
        return TrainingMean(Estimate(value, None, None), k, None, None)
    student = _student(scores)
    methods: list[_Student | RandomWeights] = [student]
    if bounds is not None:
        methods += _extensions(student, scores, None, bounds)
    return TrainingMean(_estimate(methods, value, bounds), k, student.between[0], student.episodes)


def difference_over_trainings(
    a: Array, b: Array, bounds: Bounds, narrow: float = 0.90, wide: float = 0.95
) -> CrossedDifference:
    """Mean of scores a (trainings, episodes) minus that of b, whose columns are the same episodes.

    A learner of a single training counts as it is: what is said holds for that network. `bounds` are those of each
    score, `narrow` and `wide` the confidences of the narrower and of the wider interval. Two groups have Welch's
    degrees of freedom.
    """
    a, b = _table(a), _table(b)
    student = _student(a, b)
    most = bounds[1] - bounds[0]
    possible = (min(-most, student.value), max(most, student.value))
    methods: list[_Student | RandomWeights] = [student, *_extensions(student, a, b, bounds)]
    return CrossedDifference(
        _estimate(methods, student.value, possible),
        _estimate(methods, student.value, possible, narrow),
        max(method.p() for method in methods),
        _estimate(methods, student.value, possible, wide),
    )


@dataclass(frozen=True)
class _Student:
    """A normal mean with a standard error."""

    value: float
    error: float
    freedom: float
    between: tuple[float, ...]
    """Standard deviation between the trainings of each learner; 0 for a single one."""
    episodes: float
    """Standard deviation that is common to all trainings."""

    def limits(self, confidence: float = 0.95) -> Bounds:
        half = self.error * float(stats.t.ppf((1 + confidence) / 2, self.freedom))
        return self.value - half, self.value + half

    def p(self) -> float:
        if self.error == 0:
            return float(self.value == 0)
        return float(2 * stats.t.sf(abs(self.value) / self.error, self.freedom))


def _student(a: Array, b: Array | None = None) -> _Student:
    learners = [a] if b is None else [a, b]
    n = a.shape[1]
    parts, rests, between = [], [], []
    for scores in learners:
        k, rows = len(scores), scores.mean(axis=1, keepdims=True)
        rest = 0.0
        if k > 1 and n > 1:
            deviations = scores - rows - scores.mean(axis=0, keepdims=True) + scores.mean()
            rest = float((deviations**2).sum()) / ((k - 1) * (n - 1))
        variance = float(np.var(rows, ddof=1)) if k > 1 else 0.0
        parts.append(variance / k)
        rests.append(rest / k)
        between.append(max(0.0, variance - rest / n) ** 0.5)
    columns = a.mean(axis=0) - (0.0 if b is None else b.mean(axis=0))
    episodes = max(0.0, float(np.var(columns, ddof=1)) - sum(rests)) if n > 1 else 0.0
    freedoms = [len(scores) - 1 for scores in learners]
    if sum(parts) > 0:
        freedom = sum(parts) ** 2 / sum(part**2 / max(one, 1) for part, one in zip(parts, freedoms, strict=True))
    else:
        freedom = float(min(one for one in freedoms if one))
    return _Student(float(columns.mean()), (sum(parts) + episodes / n) ** 0.5, freedom, tuple(between), episodes**0.5)


def _extensions(student: _Student, a: Array, b: Array | None, bounds: Bounds) -> list[RandomWeights]:
    """Random weights of the episodes, and of trainings as well if these may not be normal."""
    found = [_random_weights(a, b, bounds, trainings=False)]
    means = [float(a.mean()), 0.0 if b is None else float(b.mean())]
    low, high = (abs(limit - student.value) for limit in student.limits())
    for scores, mean, between in zip((a, b), means, student.between, strict=False):
        if scores is None or len(scores) < 2:
            continue
        if mean - max(low, FAR * between) <= scores.min() or mean + max(high, FAR * between) >= scores.max():
            return [*found, _random_weights(a, b, bounds, trainings=True)]
    return found


def _random_weights(a: Array, b: Array | None, bounds: Bounds, *, trainings: bool) -> RandomWeights:
    lowest = min(bounds[0], a.min(), a.min() if b is None else b.min())
    highest = max(bounds[1], a.max(), a.max() if b is None else b.max())
    together = a if b is None else np.vstack((a, b))
    columns, counts = np.unique(together, axis=1, return_counts=True)
    rng, draws = np.random.default_rng(0), []
    for weights, at_bound in random_weights(counts, rng):
        means, seen = weights @ columns.T, weights.sum(axis=1)
        low, high = _weighted(means[:, : len(a)], seen, (lowest, highest), trainings, rng)
        worst, best = at_bound[:, 0] * lowest, at_bound[:, 0] * highest
        if b is not None:
            other_low, other_high = _weighted(means[:, len(a) :], seen, (lowest, highest), trainings, rng)
            low, high, worst, best = low - other_high, high - other_low, worst - best, best - worst
        draws.append((low + worst, high + best))
    return RandomWeights(*np.concatenate(draws, axis=1))


def _weighted(
    means: Array, seen: Array, bounds: Bounds, trainings: bool, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Mean over trainings, lowest and highest (r,), of means (r, k) of episodes whose weights add up to `seen` (r,)."""
    if not trainings or means.shape[1] < 2:
        return means.mean(axis=1), means.mean(axis=1)
    weights = rng.standard_exponential((len(means), means.shape[1] + 1))
    weights /= weights.sum(axis=1, keepdims=True)
    inside, more = (weights[:, :-1] * means).sum(axis=1), weights[:, -1] * seen
    return inside + more * bounds[0], inside + more * bounds[1]


def _estimate(
    methods: Sequence[_Student | RandomWeights], value: float, possible: Bounds | None, confidence: float = 0.95
) -> Estimate:
    lows, highs = zip(*(method.limits(confidence) for method in methods), strict=True)
    low, high = min(lows), max(highs)
    if possible is not None:
        low, high = max(low, min(possible[0], value)), min(high, max(possible[1], value))
    return Estimate(value, low, high)


def _table(scores: Array) -> Array:
    scores = np.asarray(scores, dtype=float)
    if scores.ndim != 2 or 0 in scores.shape:
        raise ValueError(f"scores must have the shape (trainings, episodes), not {scores.shape}")
    return scores


def interquartile_mean(scores: Sequence[Array]) -> Estimate | None:
    """Mean of the middle half of all scores (Agarwal et al. 2021), for scores over trainings.

    Over episodes it would hide failures: with a quarter of them lost, it is still the mean of wins. `scores` are those
    of each training, (k,) each. The percentile bootstrap resamples each separately.
    """
    strata = [np.asarray(one, dtype=float) for one in scores if len(one)]
    if not strata:
        return None

    def statistic(*strata: Array, axis: int = -1) -> Any:
        return stats.trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis)

    return bootstrapped(float(statistic(*strata)), strata, statistic)
