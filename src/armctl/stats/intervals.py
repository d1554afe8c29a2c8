"""Statistics of finitely many episodes: intervals that hold when disasters are rare, probability of superiority."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import scipy
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.stats.binomial import clopper_pearson, fair_coin_p, quantile

Bounds = tuple[float, float]
"""Least and largest value that is possible."""

FEWEST = 10
"""Least number of values for a confidence interval of a mean: returns and lengths are skewed."""
DRAWS = 4000
"""Number of random weights. Where means are normal, a limit's standard error is 2 % of the interval's half width."""
LARGEST_BATCH = 4_000_000
"""Weights that are drawn at once."""
MAX_VALUES, GROUPS = 10_000, 500
"""Different values that get random weights of their own. More are drawn as so many groups of neighbours."""
RESAMPLES = 2000
"""Number of resamples of a bootstrap: the error of a 95 % interval's bound is about a tenth of the interval's width."""


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % confidence interval."""

    value: float
    low: float | None
    """None, like `high`, if the interval is unknown."""
    high: float | None

    @property
    def bounds(self) -> Bounds:
        """The interval; NaN where it is unknown."""
        return (math.nan if self.low is None else self.low), (math.nan if self.high is None else self.high)

    def __neg__(self) -> "Estimate":
        return self._subtracted_from(0.0)

    @property
    def complement(self) -> "Estimate":
        """1 minus a probability."""
        return self._subtracted_from(1.0)

    def _subtracted_from(self, whole: float) -> "Estimate":
        low, high = (None if bound is None else whole - bound for bound in (self.low, self.high))
        return Estimate(whole - self.value, high, low)


def success_rate(successes: NDArray[np.bool_]) -> Estimate | None:
    """Return the success rate with the exact interval of Clopper and Pearson (1934); None without episodes."""
    if not len(successes):
        return None
    return Estimate(float(successes.mean()), *clopper_pearson(int(successes.sum()), len(successes)))


@dataclass(frozen=True)
class RandomWeights:
    """Draws of a statistic under random weights: of its lower limit and of its upper one, both (draws,)."""

    low: Array
    high: Array

    def limits(self, confidence: float = 0.95) -> Bounds:
        """Return the confidence interval."""
        tail = (1 - confidence) / 2
        return float(np.quantile(self.low, tail)), float(np.quantile(self.high, 1 - tail))

    def p(self) -> float:
        """Return the two-sided p-value for a value of 0, of at least 2 / (draws + 1)."""
        beyond = min(int((self.low <= 0).sum()), int((self.high >= 0).sum()))
        return min(1.0, 2 * (beyond + 1) / (len(self.low) + 1))


def bounded_mean(values: Array, bounds: Bounds, confidence: float = 0.95) -> Estimate | None:
    """Return the mean of values (k,) that cannot lie outside `bounds`; None without values.

    The interval holds for disasters that are too rare to have occurred, which Student's does not know. Its limits are
    those of Gaffke (Mathematical Methods of Statistics 14, 2005; Learned-Miller and Thomas, arXiv:1905.06208): 2.5 and
    97.5 % quantiles of the mean under random weights, with a value at the bound in addition. For values of 0 and 1, it
    is Clopper and Pearson's; for many values and no rare ones, Student's. `benchmarks/intervals.py` simulates it.
    """
    result = bounded_difference(values, bounds, confidence)
    return None if result is None else result.simultaneous


class AnyConfidence:
    """A value whose interval of any confidence is computed when it is asked for, and is in no record of its fields."""

    def by(self, interval: Callable[[float], Estimate]) -> Self:
        """Set what returns the value with an interval; return the object."""
        vars(self)["_interval"] = interval
        return self

    def at(self, confidence: float) -> Estimate:
        """Return the value with its interval of another confidence."""
        interval: Callable[[float], Estimate] = vars(self)["_interval"]
        return interval(confidence)


@dataclass(frozen=True)
class MeanDifference:
    """Difference of means, or mean of paired differences."""

    estimate: Estimate
    simultaneous: Estimate
    """Mean with the interval of another confidence."""
    p: float
    """Two-sided p-value for a mean of 0."""


def bounded_difference(values: Array, bounds: Bounds, confidence: float = 0.95) -> MeanDifference | None:
    """Return the mean of paired differences (k,), with the intervals of 95 % and of `confidence`, and its p-value."""
    return _bounded(values, bounds, _weighted_means, confidence)


def worst_decile(values: Array, bounds: Bounds | None) -> Estimate | None:
    """Return the mean of the worst tenth of values (k,), the conditional value at risk, as `bounded_mean`.

    Without bounds, the interval is unknown.
    """

    def statistic(ordered: Array, weights: Array) -> Array:
        reached = np.minimum(np.cumsum(weights, axis=1, out=weights), 0.1, out=weights)
        reached[:, 1:] -= reached[:, :-1]
        return _weighted_means(ordered, reached) / 0.1

    if bounds is None:
        equal = np.full((1, len(values)), 1 / max(len(values), 1))
        return Estimate(float(statistic(np.sort(values), equal)[0]), None, None) if len(values) else None
    result = _bounded(values, bounds, statistic)
    return None if result is None else result.estimate


def _bounded(
    values: Array, bounds: Bounds, statistic: Callable[[Array, Array], Array], confidence: float = 0.95
) -> MeanDifference | None:
    if not len(values):
        return None
    weighted = _random_weights(values, bounds, statistic, np.random.default_rng(0))
    ordered, counts = np.unique(values, return_counts=True)
    lowest, highest = min(bounds[0], ordered[0]), max(bounds[1], ordered[-1])
    value = float(np.clip(statistic(ordered, counts[None] / counts.sum())[0], ordered[0], ordered[-1]))

    def estimate(confidence: float) -> Estimate:
        low, high = np.clip(weighted.limits(confidence), (lowest, value), (value, highest))
        return Estimate(value, float(low), float(high))

    return MeanDifference(estimate(0.95), estimate(confidence), weighted.p())


def _weighted_means(ordered: Array, weights: Array) -> Array:
    return np.asarray(np.einsum("ij,j->i", weights, ordered))  # after `@`, threads of BLAS keep a core busy for a while


def mean_of_means(samples: Sequence[Array], bounds: Bounds) -> Estimate | None:
    """Return the mean of the means of independent samples, (k,) each, of the same weight each; None without any."""
    samples = [values for values in samples if len(values)]
    return bounded_sum(samples, [1 / len(samples)] * len(samples), bounds).estimate if samples else None


def bounded_sum(
    samples: Sequence[Array], coefficients: Sequence[float], bounds: Bounds, confidence: float = 0.95
) -> MeanDifference:
    """Return the sum of the means of independent samples, (k,) each, times coefficients: a difference for 1 and -1.

    The intervals and the p-value are those of `bounded_mean`, from means of each sample under random weights of its
    own. They take no variances to be equal, and no mean to be normal.
    """
    rng = np.random.default_rng(0)
    parts = [_random_weights(values, bounds, _weighted_means, rng) for values in samples]
    weighted, value = weighted_sum(parts, coefficients), 0.0
    for values, coefficient in zip(samples, coefficients, strict=True):
        value += coefficient * float(values.mean())

    def estimate(confidence: float) -> Estimate:
        low, high = weighted.limits(confidence)
        return Estimate(value, min(low, value), max(high, value))

    return MeanDifference(estimate(0.95), estimate(confidence), weighted.p())


def weighted_sum(parts: Sequence[RandomWeights], coefficients: Sequence[float]) -> RandomWeights:
    """Return the draws of a sum of statistics times coefficients, from the draws of each."""
    ends = [(part.low, part.high)[:: 1 if c > 0 else -1] for part, c in zip(parts, coefficients, strict=True)]
    low, high = (np.tensordot(coefficients, [two[side] for two in ends], axes=1) for side in (0, 1))
    return RandomWeights(low, high)


def _random_weights(
    values: Array, bounds: Bounds, statistic: Callable[[Array, Array], Array], rng: np.random.Generator
) -> RandomWeights:
    """Draw a `statistic` of ordered values (m,) and weights (r, m), whose rows add up to 1; it returns (r,).

    It may write over the weights.
    """
    ordered, counts = grouped(*np.unique(values, return_counts=True))
    lowest, highest = min(bounds[0], values.min()), max(bounds[1], values.max())
    draws = [
        (
            statistic(np.concatenate(([lowest], ordered)), np.hstack((at_bound, weights))),
            statistic(np.concatenate((ordered, [highest])), np.hstack((weights, at_bound))),
        )
        for weights, at_bound in random_weights(counts, rng)
    ]
    return RandomWeights(*np.concatenate(draws, axis=1))


def grouped(ordered: Array, counts: NDArray[np.intp]) -> tuple[Array, NDArray[np.intp]]:
    """Return ordered values (m,) and their counts; of too many, means of neighbours and sums of counts.

    A group spans at most 1 / 250 of the values' range, and several values have at most 1 / 250 of the counts.
    Random weights of a group add up to those of its values, so that an interval loses only what varies within groups:
    a hundred-thousandth of its width for exponential values, and 3 in 10,000 for Cauchy's.
    """
    if len(ordered) <= MAX_VALUES:
        return ordered, counts
    place = (ordered - ordered[0]) / (ordered[-1] - ordered[0]) + np.cumsum(counts) / counts.sum()
    starts = np.flatnonzero(np.diff(np.floor(place * GROUPS / 2), prepend=-1.0))
    sizes = np.add.reduceat(counts, starts)
    return np.add.reduceat(ordered * counts, starts) / sizes, sizes


def random_weights(counts: NDArray[np.intp], rng: np.random.Generator) -> Iterator[tuple[Array, Array]]:
    """Yield weights (r, m) of m values with these counts, and (r, 1) of one at the bound, in batches; `DRAWS` rows.

    Each row adds up to 1.
    """
    rows = max(1, LARGEST_BATCH // len(counts))
    for first in range(0, DRAWS, rows):
        weights = rng.standard_gamma(counts, size=(min(rows, DRAWS - first), len(counts)))
        at_bound = rng.standard_exponential((len(weights), 1))
        total = weights.sum(axis=1, keepdims=True) + at_bound
        weights /= total
        yield weights, at_bound / total


def median(values: Array) -> Estimate | None:
    """Return the median with the interval of its order statistics (Conover 1999, section 3.2); None without values.

    The interval is unknown for fewer than `FEWEST` values.
    """
    if not len(values):
        return None
    value = float(np.median(values))
    if len(values) < FEWEST:
        return Estimate(value, None, None)
    ordered, rank = np.sort(values), int(quantile(0.025, np.asarray(float(len(values))), 0.5))
    return Estimate(value, float(ordered[rank]), float(ordered[-1 - rank]))


def sign_of_difference(a: Array, b: Array) -> Array:
    """Return the sign of a - b, also of infinite scores: two failures of policies are a tie."""
    return np.asarray(np.greater(a, b), dtype=float) - np.less(a, b)


@dataclass(frozen=True)
class Superiority:
    """Probability that one policy's score is above another's; a tie counts half."""

    probability: Estimate
    p: float
    """Two-sided p-value for a probability of one half."""


def paired_superiority(a: Array, b: Array) -> Superiority:
    """Return the superiority of scores a (k,) over b (k,) of the *same* episodes, as `bounded_mean`.

    The p-value is that of the sign test, which leaves out ties (Conover 1999, section 3.4).
    """
    wins = (sign_of_difference(a, b) + 1) / 2
    decided = int((wins != 0.5).sum())
    p = fair_coin_p(int((wins == 1).sum()), decided)
    probability = bounded_mean(wins, (0.0, 1.0))
    assert probability is not None
    return Superiority(probability, p)


def bootstrapped(value: float, samples: Sequence[Array], statistic: Any) -> Estimate:
    """Return the percentile interval of samples that are resampled separately; unknown for few or identical values."""
    if sum(map(len, samples)) < FEWEST or min(map(len, samples)) < 2:
        return Estimate(value, None, None)
    rows = max(1, 2_000_000 // sum(map(len, samples)))
    interval = scipy.stats.bootstrap(
        samples, statistic, n_resamples=RESAMPLES, batch=rows, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    low, high = float(interval.low), float(interval.high)
    return Estimate(value, low, high) if low < high else Estimate(value, None, None)


def performance_profile(scores: Array, thresholds: Array) -> list[Estimate]:
    """Return the share of episodes with a score above each threshold, with an exact interval (Agarwal et al. 2021).

    The profiles of Dolan and More (2002) are those of negated `performance_ratios`, at negated ratios.
    """
    shares = [success_rate(scores > threshold) for threshold in thresholds]
    return [share for share in shares if share is not None]


def performance_ratios(costs: Mapping[str, Array]) -> dict[str, Array]:
    """Return each policy's cost, (k,) and above 0, divided by the least of all policies' costs in that episode.

    After Dolan and More (2002). The cost of a failure is infinite, and so is its ratio.
    """
    lowest = np.min(list(costs.values()), axis=0)
    return {
        policy: np.divide(cost, lowest, out=np.full(len(cost), np.inf), where=np.isfinite(cost))
        for policy, cost in costs.items()
    }
