"""What can be said of finitely many episodes: intervals, and differences over paired episodes."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

FEWEST = 10
"""Values below which nothing is said of a mean's precision: returns and lengths are too skewed."""


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % confidence interval."""

    value: float
    low: float | None
    """None, like `high`, where nothing is known of it."""
    high: float | None


def success_rate(successes: NDArray[np.bool_]) -> Estimate | None:
    """Share of successes with Wilson's score interval (1927); None without episodes."""
    if not len(successes):
        return None
    result = stats.binomtest(int(successes.sum()), len(successes))
    interval = result.proportion_ci(method="wilson")
    return Estimate(float(successes.mean()), float(interval.low), float(interval.high))


def mean(values: Array) -> Estimate | None:
    """Mean with Student's t interval (1908), unknown for less than `FEWEST` values; None without values."""
    if not len(values):
        return None
    value = float(np.mean(values))
    if len(values) < FEWEST:
        return Estimate(value, None, None)
    half = float(stats.sem(values) * stats.t.ppf(0.975, len(values) - 1))
    return Estimate(value, value - half, value + half)


def median(values: Array) -> Estimate | None:
    """Median with the interval of its order statistics (Conover 1999, section 3.2), as for `mean`."""
    if not len(values):
        return None
    value = float(np.median(values))
    if len(values) < FEWEST:
        return Estimate(value, None, None)
    interval: Any = stats.quantile_test(values, p=0.5).confidence_interval(0.95)
    return Estimate(value, float(interval.low), float(interval.high))


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
    mcnemar_p: float
    """Exact two-sided p-value for equal success (McNemar 1947)."""
    return_difference: Estimate
    """Mean of return a - return b."""
    steps_difference: Estimate | None
    """Mean of steps a - steps b where both succeeded."""


def paired_difference(
    a: str,
    b: str,
    success: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    returns: tuple[Array, Array],
    lengths: tuple[Array, Array],
) -> PairedDifference:
    """Compare two policies, whose i-th entries (k,) belong to the same episode; k is at least 1."""
    success_a, success_b = success
    both = success_a & success_b
    only_a, only_b = int((success_a & ~success_b).sum()), int((success_b & ~success_a).sum())
    discordant = only_a + only_b
    return_difference = mean(returns[0] - returns[1])
    assert return_difference is not None
    return PairedDifference(
        a,
        b,
        len(both),
        int(both.sum()),
        only_a,
        only_b,
        int((~success_a & ~success_b).sum()),
        float(stats.binomtest(only_a, discordant).pvalue) if discordant else 1.0,
        return_difference,
        mean((lengths[0] - lengths[1])[both]),
    )
