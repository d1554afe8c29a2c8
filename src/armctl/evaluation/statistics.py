"""Statistics of finitely many episodes, and of few trainings: intervals, differences, probability of superiority."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

FEWEST = 10
"""Least number of values for a confidence interval of a mean: returns and lengths are skewed."""
RESAMPLES = 2000
"""Of a bootstrap. With so many, the error of a 95 % interval's bound is about a tenth of the interval's width."""


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % confidence interval."""

    value: float
    low: float | None
    """None, like `high`, if the interval is unknown."""
    high: float | None


def success_rate(successes: NDArray[np.bool_]) -> Estimate | None:
    """Success rate with Wilson's score interval (1927); None without episodes."""
    if not len(successes):
        return None
    result = stats.binomtest(int(successes.sum()), len(successes))
    interval = result.proportion_ci(method="wilson")
    return Estimate(float(successes.mean()), float(interval.low), float(interval.high))


def mean(values: Array) -> Estimate | None:
    """Mean with Student's t interval (1908), unknown for fewer than `FEWEST` values; None without values."""
    if not len(values):
        return None
    value = float(np.mean(values))
    if len(values) < FEWEST:
        return Estimate(value, None, None)
    half = float(stats.sem(values) * stats.t.ppf(0.975, len(values) - 1))
    return Estimate(value, value - half, value + half)


def median(values: Array) -> Estimate | None:
    """Median with the interval of its order statistics (Conover 1999, section 3.2); otherwise as `mean`."""
    if not len(values):
        return None
    value = float(np.median(values))
    if len(values) < FEWEST:
        return Estimate(value, None, None)
    interval: Any = stats.quantile_test(values, p=0.5).confidence_interval(0.95)
    return Estimate(value, float(interval.low), float(interval.high))


def interquartile_mean(scores: Sequence[Array]) -> Estimate | None:
    """Mean of the middle half of all scores (Agarwal et al. 2021); no interval for fewer than `FEWEST` scores.

    `scores` are those of each training seed, (k,) each. The percentile bootstrap resamples each seed separately. The
    interval covers the variation between episodes, not that between trainings: see `mean_over_trainings`.
    """
    strata = [np.asarray(one, dtype=float) for one in scores if len(one)]
    if not strata:
        return None

    def statistic(*strata: Array, axis: int = -1) -> Any:
        return stats.trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis)

    return _bootstrapped(float(statistic(*strata)), strata, statistic)


@dataclass(frozen=True)
class Superiority:
    """Probability that one policy's score is above another's; a tie counts half."""

    probability: Estimate
    p: float
    """Two-sided p-value for a probability of one half."""


def superiority(a: Array, b: Array) -> Superiority:
    """Superiority of scores a (k,) over b (m,) of *other* episodes: Mann and Whitney (1947), bootstrap interval."""

    def statistic(a: Array, b: Array, axis: int = -1) -> Any:
        wins: Any = stats.mannwhitneyu(a, b, axis=axis, method="asymptotic").statistic
        return wins / (a.shape[axis] * b.shape[axis])

    probability = _bootstrapped(float(statistic(a, b)), [a, b], statistic)
    equal = np.ptp(np.concatenate((a, b))) == 0
    return Superiority(probability, 1.0 if equal else float(stats.mannwhitneyu(a, b).pvalue))


def paired_superiority(a: Array, b: Array) -> Superiority:
    """Superiority of scores a (k,) over scores b (k,) of the *same* episodes, which the bootstrap resamples.

    The p-value is that of the sign test, which leaves out ties (Conover 1999, section 3.4).
    """
    wins = (np.sign(a - b) + 1) / 2
    decided = int((wins != 0.5).sum())
    p = float(stats.binomtest(int((wins == 1).sum()), decided).pvalue) if decided else 1.0
    return Superiority(_bootstrapped(float(wins.mean()), [wins], np.mean), p)


def _bootstrapped(value: float, samples: Sequence[Array], statistic: Any) -> Estimate:
    """Percentile interval of samples that are resampled separately; unknown for few or identical values."""
    if sum(map(len, samples)) < FEWEST or min(map(len, samples)) < 2:
        return Estimate(value, None, None)
    rows = max(1, 2_000_000 // sum(map(len, samples)))
    interval = stats.bootstrap(
        samples, statistic, n_resamples=RESAMPLES, batch=rows, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    low, high = float(interval.low), float(interval.high)
    return Estimate(value, low, high) if low < high else Estimate(value, None, None)


def performance_profile(scores: Array, thresholds: Array) -> list[Estimate]:
    """Share of episodes with a score above each threshold, with Wilson's interval at each (Agarwal et al. 2021).

    The profiles of Dolan and More (2002) are those of negated `performance_ratios`, at negated ratios.
    """
    shares = [success_rate(scores > threshold) for threshold in thresholds]
    return [share for share in shares if share is not None]


def performance_ratios(costs: Mapping[str, Array]) -> dict[str, Array]:
    """Each policy's cost, (k,) and above 0, divided by the least of all policies' costs in that episode.

    After Dolan and More (2002). The cost of a failure is infinite, and so is its ratio.
    """
    least = np.min(list(costs.values()), axis=0)
    return {
        policy: np.divide(cost, least, out=np.full(len(cost), np.inf), where=np.isfinite(cost))
        for policy, cost in costs.items()
    }


@dataclass(frozen=True)
class TrainingMean:
    """A mean over several trainings of one recipe, each with several episodes."""

    mean: Estimate
    """Mean of the trainings' means; no interval for a single training."""
    trainings: int
    between: float | None
    """Standard deviation between trainings, without the part due to their episodes; None for a single one."""
    within: float | None
    """Standard deviation between episodes of one training; None with one episode each."""


def mean_over_trainings(scores: Sequence[Array]) -> TrainingMean:
    """Mean over trainings, each with scores of its episodes, (k,) and not empty.

    The question is how other trainings would turn out. So the interval is Student's over the trainings' means, however
    many episodes each has. The variance components are those of one-way random effects (Montgomery 2012, section 3.9).
    """
    means = np.array([np.mean(one) for one in scores])
    episodes = [one for one in scores if len(one) > 1]
    degrees = sum(len(one) - 1 for one in episodes)
    within = sum(float(np.var(one)) * len(one) for one in episodes) / degrees if degrees else None
    value = float(means.mean())
    scatter = None if within is None else within**0.5
    if len(means) < 2:
        return TrainingMean(Estimate(value, None, None), len(means), None, scatter)
    half = float(stats.sem(means) * stats.t.ppf(0.975, len(means) - 1))
    by_episodes = (within or 0.0) * float(np.mean([1 / len(one) for one in scores]))
    between = max(0.0, float(np.var(means, ddof=1)) - by_episodes) ** 0.5
    return TrainingMean(Estimate(value, value - half, value + half), len(means), between, scatter)


@dataclass(frozen=True)
class PairedDifference:
    """Policy a against policy b on the same episodes."""

    a: str
    b: str
    episodes: int
    both: int
    only_a: int
    only_b: int
    neither: int
    mcnemar_p: float | None
    """Exact two-sided p-value for equal success (McNemar 1947); None, with counts of 0, if success is unknown."""
    return_difference: Estimate
    """Mean of return a - return b."""
    superiority: Superiority
    """Of return a over return b."""
    steps_difference: Estimate | None
    """Mean of steps a - steps b where both succeeded."""


def mcnemar(only_a: int, only_b: int) -> float:
    """Exact two-sided p-value for equal success, from how many episodes only a and only b won (McNemar 1947)."""
    return float(stats.binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


def paired_difference(
    a: str,
    b: str,
    success: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None,
    returns: tuple[Array, Array],
    lengths: tuple[Array, Array],
) -> PairedDifference:
    """Compare two policies. The i-th entries (k,) of both belong to the same episode; k is at least 1.

    `success` is None if it is unknown.
    """
    k = len(returns[0])
    success_a, success_b = success or (np.zeros(k, dtype=bool), np.zeros(k, dtype=bool))
    both = success_a & success_b
    only_a, only_b = int((success_a & ~success_b).sum()), int((success_b & ~success_a).sum())
    return_difference = mean(returns[0] - returns[1])
    assert return_difference is not None
    return PairedDifference(
        a,
        b,
        len(both),
        int(both.sum()),
        only_a,
        only_b,
        0 if success is None else int((~success_a & ~success_b).sum()),
        None if success is None else mcnemar(only_a, only_b),
        return_difference,
        paired_superiority(*returns),
        mean((lengths[0] - lengths[1])[both]),
    )
