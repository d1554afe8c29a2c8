"""Two policies on the same episodes: difference in success, and equivalence."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from armctl.stats.intervals import (
    Array,
    Bounds,
    Estimate,
    MeanDifference,
    Superiority,
    bounded_difference,
    bounded_mean,
    paired_superiority,
    sign_of_difference,
)
from armctl.stats.trainings import CrossedDifference, difference_over_trainings, superiority_over_trainings

EQUIVALENCE = 0.05
"""Level of each of the two tests that show equivalence."""
SIGNIFICANT = 0.05
"""Largest p-value of a difference that is told."""
LEVELS = 3
"""Tests of a pair: success, steps and return."""
UNCERTAINTY = 0.05
"""Of an interval, shared between the pairs for which it is to hold at once."""
MARGIN = 0.02
"""Largest difference in success of policies that count as equivalent, unless another one is given."""


@dataclass(frozen=True)
class Simultaneous:
    """Intervals that hold at once for all pairs of a comparison: each at 95 %, its 5 % divided by their number."""

    returns: Estimate
    superiority: Estimate
    steps: Estimate | None


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
    """Exact two-sided p-value for equal success (McNemar 1947), or that of `crossed`; None if success is unknown.

    Then counts are 0. With several trainings, they are means over these."""
    return_difference: Estimate
    """Mean of return a - return b; its interval is unknown where the possible returns are."""
    superiority: Superiority
    """Of return a over return b."""
    steps_difference: Estimate | None
    """Mean of steps to the goal of a - those of b, a failure counting as the time limit; None without a limit."""
    return_p: float | None = None
    """Two-sided p-value for equal returns in the mean; None where the possible returns are unknown."""
    crossed: CrossedDifference | None = None
    """In success, if a or b is several trainings and success is known."""
    steps_p: float | None = None
    """Two-sided p-value for equal steps to the goal in the mean; None without `steps_difference`, and in results of
    older versions."""
    simultaneous: Simultaneous | None = None
    """None in results of older versions."""

    @property
    def success_difference(self) -> Estimate | None:
        """Success rate of a minus that of b, with its 95 % interval; None if success is unknown."""
        return self.success_among(1)

    def success_among(self, claims: int) -> Estimate | None:
        """The same with an interval that holds at once for so many pairs; over trainings, for all of the comparison."""
        if self.crossed is not None:
            return self.crossed.estimate if claims == 1 else self.crossed.wide or self.crossed.estimate
        if self.mcnemar_p is None:
            return None
        return mover(self.only_a, self.only_b, self.episodes, 1 - UNCERTAINTY / claims)

    def equivalent(self, margin: float, claims: int = 1) -> bool:
        """Whether success differs by less than `margin`: two one-sided tests (Schuirmann 1987) at 5 % / `claims`."""
        if self.mcnemar_p is None:
            return False
        level = 1 - 2 * EQUIVALENCE / claims
        found = self.crossed.narrow if self.crossed else mover(self.only_a, self.only_b, self.episodes, level)
        return within(found, margin)


def within(difference: Estimate, margin: float) -> bool:
    """Whether the whole interval of a difference is smaller than `margin`."""
    low, high = difference.bounds
    return -margin < low and high < margin


def shown(difference: Estimate, p: float | None) -> bool:
    """Whether a difference is significant, and its interval says so too."""
    low, high = difference.bounds
    return p is not None and p < SIGNIFICANT and (low > 0 or high < 0)


@dataclass(frozen=True)
class Corrected:
    """The p-values of a pair after Holm's correction; None where they are unknown."""

    success: float | None
    """Of equal success."""
    steps: float | None
    """Of equal steps to the goal in the mean."""
    returns: float | None
    """Of equal returns in the mean."""
    higher: float
    """Of equal chances for the higher return (sign test), told only where success is unknown."""
    tests: int
    """For how many tests success, steps and returns were corrected together."""
    pairs: int
    """For how many pairs the sign test was corrected."""


def corrected(pairs: Sequence[PairedDifference], baseline: str | None = None) -> list[Corrected]:
    """The p-values of each pair, after Holm's correction for all pairs, and for success, steps and returns together.

    A verdict may tell any of the three, also steps and returns where success does not differ significantly, so that no
    order of tests would make up for their number. The sign test is corrected for all pairs. With a `baseline`, the
    pairs against it are a family of their own; otherwise, and for all others, it is all pairs.
    """
    own = [i for i, pair in enumerate(pairs) if baseline in (pair.a, pair.b)]
    among_own = dict(zip(own, _corrected([pairs[i] for i in own]), strict=True))
    return [among_own.get(i, one) for i, one in enumerate(_corrected(pairs))]


def _corrected(pairs: Sequence[PairedDifference]) -> list[Corrected]:
    p = [one for pair in pairs for one in (pair.mcnemar_p, pair.steps_p, pair.return_p)]
    known = [i for i, one in enumerate(p) if one is not None]
    adjusted = dict(zip(known, holm([one for one in p if one is not None]), strict=True))
    higher = holm([pair.superiority.p for pair in pairs])
    found = []
    for i in range(len(pairs)):
        success, steps, returns = (adjusted.get(LEVELS * i + level) for level in range(LEVELS))
        found.append(Corrected(success, steps, returns, higher[i], len(known), len(pairs)))
    return found


def mcnemar(only_a: int, only_b: int) -> float:
    """Exact two-sided p-value for equal success, from how many episodes only a and only b won (McNemar 1947)."""
    return float(stats.binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


@lru_cache(maxsize=10_000)
def mover(only_a: float, only_b: float, episodes: int, confidence: float = 0.95) -> Estimate:
    """Difference in success of paired episodes, from how many only a and only b won.

    Its limits are put together from Clopper and Pearson's of both shares, whose multinomial correlation is known (Zou
    and Donner, Statistics in Medicine 27, 2008). Where hardly anything was discordant, they miss on neither side in
    more than 2.5 % of comparisons, unlike Tango's score interval (up to 5 %).
    """
    a, b = only_a / episodes, only_b / episodes
    correlation = -math.sqrt(a * b / ((1 - a) * (1 - b))) if a * b else 0.0
    (low_a, high_a), (low_b, high_b) = (_share(count, episodes, confidence) for count in (only_a, only_b))

    def distance(of_a: float, of_b: float) -> float:
        return math.sqrt(of_a**2 - 2 * correlation * of_a * of_b + of_b**2)

    low, high = a - b - distance(a - low_a, high_b - b), a - b + distance(high_a - a, b - low_b)
    return Estimate(a - b, max(low, -1.0), min(high, 1.0))


def _share(count: float, episodes: int, confidence: float) -> Bounds:
    """Clopper and Pearson's interval."""
    tail, rest = (1 - confidence) / 2, episodes - count
    low = float(stats.beta.ppf(tail, count, rest + 1)) if count > 0 else 0.0
    return low, float(stats.beta.ppf(1 - tail, count + 1, rest)) if rest > 0 else 1.0


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values for one claim of several, corrected for their number (Holm 1979), in the same order."""
    order = np.argsort(p_values)
    corrected = np.asarray(p_values, dtype=float)[order] * np.arange(len(p_values), 0, -1)
    result = np.empty(len(p_values))
    result[order] = np.minimum(np.maximum.accumulate(corrected), 1.0)
    return [float(p) for p in result]


def paired_difference(
    a: str,
    b: str,
    success: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None,
    returns: tuple[Array, Array],
    steps: tuple[Array, Array] | None,
    return_bounds: Bounds | None,
    time_limit: int | None = None,
    claims: int = 1,
) -> PairedDifference:
    """Compare two policies. The i-th entries (k,) of both belong to the same episode; k is at least 1.

    `success` is None if it is unknown, `steps` are the restricted steps to the goal. `return_bounds` are those of each
    policy's return, None if nobody knows them. `claims` is for how many pairs the simultaneous intervals hold.
    """
    k = len(returns[0])
    success_a, success_b = success or (np.zeros(k, dtype=bool), np.zeros(k, dtype=bool))
    both = success_a & success_b
    only_a, only_b = int((success_a & ~success_b).sum()), int((success_b & ~success_a).sum())
    level = 1 - UNCERTAINTY / claims
    gained, wide, return_p = _return_difference(returns, return_bounds, level)
    late = _steps_difference(steps, time_limit, level)
    higher = bounded_mean((sign_of_difference(*returns) + 1) / 2, (0.0, 1.0), level)
    assert higher is not None
    return PairedDifference(
        a,
        b,
        len(both),
        int(both.sum()),
        only_a,
        only_b,
        0 if success is None else int((~success_a & ~success_b).sum()),
        None if success is None else mcnemar(only_a, only_b),
        gained,
        paired_superiority(*returns),
        late.estimate if late else None,
        return_p,
        steps_p=late.p if late else None,
        simultaneous=Simultaneous(wide, higher, late.wide if late else None),
    )


def _return_difference(
    returns: tuple[Array, Array], return_bounds: Bounds | None, confidence: float
) -> tuple[Estimate, Estimate, float | None]:
    """Mean difference in return with both intervals, and its p-value: all unknown if the possible returns are."""
    if return_bounds is None:
        unknown = _without_interval(*returns)
        return unknown, unknown, None
    most = return_bounds[1] - return_bounds[0]
    found = bounded_difference(returns[0] - returns[1], (-most, most), confidence)
    assert found is not None
    return found.estimate, found.wide, found.p


def _without_interval(a: Array, b: Array) -> Estimate:
    """Difference between mean returns; NaN where the return of an episode is not known, since a policy failed in it."""
    known = np.isfinite(a).all() and np.isfinite(b).all()
    return Estimate(float(a.mean() - b.mean()) if known else math.nan, None, None)


def _steps_difference(
    steps: tuple[Array, Array] | None, time_limit: int | None, confidence: float
) -> MeanDifference | None:
    if steps is None or time_limit is None:
        return None
    return bounded_difference(steps[0] - steps[1], (1.0 - time_limit, time_limit - 1.0), confidence)


def difference_of_groups(
    a: str,
    b: str,
    success: tuple[Array, Array] | None,
    returns: tuple[Array, Array],
    steps: tuple[Array, Array] | None,
    return_bounds: Bounds | None,
    time_limit: int | None = None,
    claims: int = 1,
) -> PairedDifference:
    """Compare two learners, at least one of which is several trainings.

    As `paired_difference`, for arrays of shape (trainings, episodes), of which a learner has one row or more. `claims`
    is also for how many pairs equivalence may be claimed.
    """
    narrow, wide = 1 - 2 * EQUIVALENCE / claims, 1 - UNCERTAINTY / claims
    known = all(np.isfinite(scores).all() for scores in returns)  # else a policy failed, at an unknown cost
    paid = returns if known else (np.full_like(returns[0], math.nan), np.full_like(returns[1], math.nan))
    earned = difference_over_trainings(*paid, return_bounds, wide=wide)
    higher, simultaneous = superiority_over_trainings(*returns, wide)
    late = None
    if steps is not None and time_limit is not None:
        late = difference_over_trainings(*steps, (1.0, float(time_limit)), wide=wide)
    crossed, both, only_a, only_b, neither = None, 0, 0, 0, 0
    if success is not None:
        crossed = difference_over_trainings(*success, (0.0, 1.0), narrow, wide)
        won, other = success[0][:, None], success[1]
        shares = [float(one.mean()) for one in (won * other, won * (1 - other), (1 - won) * other)]
        ends = np.rint(np.cumsum([0.0, *shares, 1.0 - sum(shares)]) * won.shape[-1])
        both, only_a, only_b, neither = np.diff(ends).astype(int).tolist()
    return PairedDifference(
        a,
        b,
        returns[0].shape[1],
        both,
        only_a,
        only_b,
        neither,
        crossed.p if crossed else None,
        earned.estimate,
        higher,
        late.estimate if late else None,
        earned.p,
        crossed,
        late.p if late else None,
        Simultaneous(earned.wide or earned.estimate, simultaneous, late.wide if late else None),
    )
