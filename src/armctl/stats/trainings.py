"""Statistics of few trainings of one recipe, which say how another training would turn out.

All trainings play the same episodes, so that both are crossed. What is concluded rests on random weights of trainings
*and* of episodes, as in `armctl.stats.intervals.bounded_mean`, with one more training and one more episode at the
bound. They take nothing for granted: `benchmarks/intervals.py --table trainings` simulates trainings of which one in
ten fails altogether. So from few trainings they conclude little: from three that never fail, no more than a success
rate above 29 %, which is what a recipe whose trainings fail in 71 % of cases shows with a probability of 2.5 %.

Student's t beside it, with the variance components of the analysis of variance (Searle, Casella and McCulloch, Variance
Components, 1992, section 4.4), takes trainings to vary normally. Nothing is concluded from it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from armctl.core.arrays import Array
from armctl.stats.intervals import (
    AnyConfidence,
    Bounds,
    Estimate,
    RandomWeights,
    Superiority,
    bootstrapped,
    random_weights,
    sign_of_difference,
    weighted_sum,
)

FEWEST_TRAININGS = 6
"""Least number of trainings that can show a change of a recipe: if one half of all trainings got better, it would still
occur in none of five with a probability of 3 %, on either side."""


@dataclass(frozen=True)
class TrainingMean:
    """A mean over several trainings of one recipe, which all played the same episodes."""

    mean: Estimate
    """Mean over all trainings and episodes; no interval for a single training, or without bounds."""
    if_normal: Estimate
    """Mean with Student's interval, valid if trainings and episodes vary normally; without one if nothing varies."""
    p: float | None
    """Two-sided p-value for a mean of 0; None where there is no interval."""
    trainings: int
    between_seed_std: float | None
    """Standard deviation between trainings, without the part due to their episodes; None for a single one."""
    episodes: float | None
    """Standard deviation between episodes that is common to all trainings; None for a single one."""


@dataclass(frozen=True)
class CrossedDifference(AnyConfidence):
    """A mean of one learner minus that of another, at least one of which is several trainings."""

    estimate: Estimate
    """Difference with its 95 % interval; like the next two, without an interval if scores have no bounds."""
    ci90: Estimate
    """Difference with the 90 % interval, which lies within the margin of equivalent learners; narrower of several."""
    p: float | None
    """Two-sided p-value for no difference; None if scores have no bounds."""
    simultaneous: Estimate
    """Difference with the interval that holds at once for all pairs of a comparison."""
    if_normal: Estimate
    """Difference with Student's interval, valid if trainings and episodes vary normally; without one if nothing varies.
    """

    def __neg__(self) -> "CrossedDifference":
        negative = CrossedDifference(-self.estimate, -self.ci90, self.p, -self.simultaneous, -self.if_normal)
        return negative.by(lambda confidence: -self.at(confidence))


def mean_over_trainings(scores: Array, bounds: Bounds | None = None) -> TrainingMean:
    """Return the mean of scores (trainings, episodes), whose columns are the same episodes, as for other trainings.

    `bounds` are the least and largest possible score. Without them only Student's interval is known.
    """
    scores = _table(scores)
    k = len(scores)
    value = float(scores.mean())
    unknown = Estimate(value, None, None)
    if k < 2:
        return TrainingMean(unknown, unknown, None, k, None, None)
    student = _student(scores)
    weighted = None if bounds is None else _random_weights(scores, None, bounds)
    return TrainingMean(
        _estimate(weighted, value, bounds), student.estimate(bounds), None if weighted is None else weighted.p(), k,
        student.between_seed_std, student.episodes,
    )  # fmt: skip


def difference_over_trainings(
    a: Array, b: Array, bounds: Bounds | None, narrow: float = 0.90, simultaneous: float = 0.95, paired: bool = True
) -> CrossedDifference:
    """Return the mean of scores a (trainings, episodes) minus that of b.

    Columns of both are the same episodes if they are `paired`; otherwise, each has weights of its own. A learner of a
    single training counts as it is: the result holds for that network. `bounds` are those of each score, if they are
    known, `narrow` and `simultaneous` the confidences of `ci90` and of the wider interval. Student's interval of two
    groups has Welch's degrees of freedom.
    """
    a, b = _table(a), _table(b)
    student = _student(a, b) if paired else _student(a).minus(_student(b))
    weighted, possible = None, None
    if bounds is not None:
        weighted = _random_weights(a, b, bounds) if paired else _separate_weights(a, b, bounds)
        possible = bounds[0] - bounds[1], bounds[1] - bounds[0]
    return CrossedDifference(
        _estimate(weighted, student.value, possible),
        _estimate(weighted, student.value, possible, narrow),
        None if weighted is None else weighted.p(),
        _estimate(weighted, student.value, possible, simultaneous),
        student.estimate(possible),
    ).by(partial(_estimate, weighted, student.value, possible))


def superiority_over_trainings(
    a: Array, b: Array, confidence: float = 0.95, paired: bool = True
) -> tuple[Superiority, Estimate]:
    """Return the superiority of scores a (trainings, episodes) over b: of one training of a over one of b.

    Columns of both are the same episodes if they are `paired`. Otherwise, any episode of a is held against any of b,
    and each has weights of its own, so that variances need not be equal. A learner of a single training counts as it
    is. The second estimate is the same probability with the interval of another `confidence`.
    """
    a, b = _table(a), _table(b)
    draws = (_paired_superiority if paired else _separate_superiority)(a, b, np.random.default_rng(0))
    inside, at_bound = np.concatenate(list(draws), axis=1)
    weighted = RandomWeights(inside - 0.5, inside + at_bound - 0.5)
    if paired:
        value = float((sign_of_difference(a[:, None], b).mean() + 1) / 2)
    else:
        value = float(_share_below(np.sort(b, axis=None), np.full((1, b.size), 1 / b.size), a.ravel()).mean())

    def estimate(confidence: float) -> Estimate:
        low, high = weighted.limits(confidence)
        return _within(value, (low + 0.5, high + 0.5), (0.0, 1.0))

    return Superiority(estimate(0.95), weighted.p()), estimate(confidence)


def _paired_superiority(a: Array, b: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Yield the superiority (r,) under random weights, and the weight (r,) at the bound, in batches."""
    ahead = (sign_of_difference(a[:, None], b) + 1) / 2
    for means, total in _weighted_episodes(ahead.reshape(-1, ahead.shape[-1]), rng):
        of_a, of_b = (_training_weights(len(means), len(learner), rng) for learner in (a, b))
        inside = np.einsum("ri,rj,rij->r", of_a, of_b, means.reshape(-1, len(a), len(b)))
        yield np.array([inside, 1 - of_a.sum(axis=1) * of_b.sum(axis=1) * total])


def _separate_superiority(a: Array, b: Array, rng: np.random.Generator) -> Iterator[Array]:
    """Yield what `_paired_superiority` does, of different episodes."""
    order, first = np.argsort(b, axis=None), a.shape[1] + 1
    for weights, _ in random_weights(np.ones(first + b.shape[1] + 1, dtype=int), rng):
        scores = []
        for learner, raw in ((a, weights[:, :first]), (b, weights[:, first:])):
            of_episodes = (raw / raw.sum(axis=1, keepdims=True))[:, None, :-1]
            of_trainings = _training_weights(len(raw), len(learner), rng)[:, :, None]
            scores.append((of_trainings * of_episodes).reshape(len(raw), -1))
        inside = (scores[0] * _share_below(b.ravel()[order], scores[1][:, order], a.ravel())).sum(axis=1)
        yield np.array([inside, 1 - scores[0].sum(axis=1) * scores[1].sum(axis=1)])


def _share_below(ordered: Array, weights: Array, values: Array) -> Array:
    """Return the weight (r, k) of ordered scores (m,), with weights (r, m), below values (k,); a tie counts half."""
    sums = np.pad(np.cumsum(weights, axis=1), ((0, 0), (1, 0)))
    sides = (np.searchsorted(ordered, values, side) for side in ("left", "right"))
    return np.asarray(sum(sums[:, places] for places in sides) / 2)


@dataclass(frozen=True)
class _Student:
    """A normal mean with a standard error."""

    value: float
    error: float
    freedom: float
    between_seed_std: float
    """Standard deviation between the trainings of the first learner."""
    episodes: float
    """Standard deviation that is common to all trainings."""

    def minus(self, other: "_Student") -> "_Student":
        """Return the difference from the mean of other episodes, with Welch's degrees of freedom."""
        variances = self.error**2, other.error**2
        parts = sum(part**2 / two.freedom for part, two in zip(variances, (self, other), strict=True))
        return replace(
            self,
            value=self.value - other.value,
            error=sum(variances) ** 0.5,
            freedom=sum(variances) ** 2 / parts if parts else self.freedom,
        )

    def estimate(self, possible: Bounds | None) -> Estimate:
        """Return the mean with the 95 % interval, as far as it is possible."""
        if self.error == 0:
            return Estimate(self.value, None, None)
        half = self.error * float(scipy.stats.t.ppf(0.975, self.freedom))
        return _within(self.value, (self.value - half, self.value + half), possible)


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
        freedom = sum(parts) ** 2 / sum(part**2 / max(k, 1) for part, k in zip(parts, freedoms, strict=True))
    else:
        freedom = float(min(filter(None, freedoms), default=max(n - 1, 1)))
    return _Student(float(columns.mean()), (sum(parts) + episodes / n) ** 0.5, freedom, between[0], episodes**0.5)


def _random_weights(a: Array, b: Array | None, bounds: Bounds, rng: np.random.Generator | None = None) -> RandomWeights:
    together = a if b is None else np.vstack((a, b))
    lowest, highest = min(bounds[0], together.min()), max(bounds[1], together.max())
    rng, draws = rng or np.random.default_rng(0), []
    for means, total in _weighted_episodes(together, rng):
        low, high = _limits(means[:, : len(a)], total, lowest, highest, rng)
        if b is not None:
            other_low, other_high = _limits(means[:, len(a) :], total, lowest, highest, rng)
            low, high = low - other_high, high - other_low
        draws.append((low, high))
    return RandomWeights(*np.concatenate(draws, axis=1))


def _separate_weights(a: Array, b: Array, bounds: Bounds) -> RandomWeights:
    rng = np.random.default_rng(0)
    return weighted_sum([_random_weights(learner, None, bounds, rng) for learner in (a, b)], [1, -1])


def _weighted_episodes(scores: Array, rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """Yield sums (r, k) of scores (k, n) times random weights of episodes, and sums (r,) of the weights, in batches."""
    columns, counts = np.unique(scores, axis=1, return_counts=True)
    for weights, _ in random_weights(counts, rng):
        yield weights @ columns.T, weights.sum(axis=1)


def _training_weights(rows: int, trainings: int, rng: np.random.Generator) -> Array:
    """Draw weights (rows, trainings), which leave the rest to one more training; a single one counts as it is."""
    if trainings == 1:
        return np.ones((rows, 1))
    weights = rng.standard_exponential((rows, trainings + 1))
    return np.asarray(weights[:, :-1] / weights.sum(axis=1, keepdims=True))


def _limits(means: Array, total: Array, lowest: float, highest: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the lowest and highest means (r,) of a learner: one more training, and one more episode, at the bound."""
    weights = _training_weights(len(means), means.shape[1], rng)
    inside, at_bound = (weights * means).sum(axis=1), 1 - weights.sum(axis=1) * total
    return inside + at_bound * lowest, inside + at_bound * highest


def _estimate(
    weighted: RandomWeights | None, value: float, possible: Bounds | None, confidence: float = 0.95
) -> Estimate:
    if weighted is None:
        return Estimate(value, None, None)
    return _within(value, weighted.limits(confidence), possible)


def _within(value: float, limits: Bounds, possible: Bounds | None) -> Estimate:
    """Return a value with limits that enclose it, as far as they are possible."""
    lowest, highest = possible or (-np.inf, np.inf)
    return Estimate(value, min(value, max(limits[0], lowest)), max(value, min(limits[1], highest)))


def _table(scores: Array) -> Array:
    scores = np.asarray(scores, dtype=float)
    if scores.ndim != 2 or 0 in scores.shape:
        raise ValueError(f"scores must have the shape (trainings, episodes), not {scores.shape}")
    return scores


def interquartile_mean(scores: Sequence[Array]) -> Estimate | None:
    """Return the mean of the middle half of all scores (Agarwal et al. 2021), for scores over trainings.

    Over episodes it would hide failures: with a quarter of them lost, it is still the mean of wins. `scores` are those
    of each training, (k,) each. The percentile bootstrap resamples each separately.
    """
    strata = [np.asarray(values, dtype=float) for values in scores if len(values)]
    if not strata:
        return None

    def statistic(*strata: Array, axis: int = -1) -> Any:
        return scipy.stats.trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis)

    return bootstrapped(float(statistic(*strata)), strata, statistic)
