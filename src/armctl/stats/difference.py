"""Difference of two policies in success, steps and return, and equivalence."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from armctl.core.arrays import Array
from armctl.stats.intervals import (
    AnyConfidence,
    Bounds,
    Estimate,
    Superiority,
    bounded_difference,
    bounded_mean,
    bounded_sum,
    paired_superiority,
    sign_of_difference,
)
from armctl.stats.paired import counts_of_pairs, mcnemar, mover
from armctl.stats.trainings import CrossedDifference, difference_over_trainings, superiority_over_trainings
from armctl.stats.unpaired import newcombe, unconditional

EQUIVALENCE = 0.05
"""Level of each of the two tests that show equivalence."""
SIGNIFICANT = 0.05
"""Largest p-value of a difference that a verdict states."""
LEVELS = 3
"""Number of tests of a pair: success, steps and return."""
UNCERTAINTY = 0.05
"""Probability that an interval misses, shared between the pairs for which it holds at once."""
MARGIN = 0.02
"""Largest difference in success of policies that count as equivalent, unless another one is given."""


@dataclass(frozen=True)
class Simultaneous:
    """Intervals that hold at once for all pairs of a comparison: each at 95 %, its 5 % divided by their number."""

    returns: Estimate
    superiority: Estimate
    steps: Estimate | None


@dataclass(frozen=True)
class SuccessIntervals(AnyConfidence):
    """Difference in success with intervals that hold at any number of episodes."""

    estimate: Estimate
    simultaneous: Estimate

    def __neg__(self) -> "SuccessIntervals":
        return SuccessIntervals(-self.estimate, -self.simultaneous).by(lambda confidence: -self.at(confidence))


@dataclass(frozen=True)
class Difference:
    """Policy a against policy b."""

    a: str
    b: str
    sample_sizes: tuple[int, int]
    """Numbers of episodes of a and of b."""
    return_difference: Estimate
    """Mean of return a - return b; its interval is unknown where the possible returns are."""
    superiority: Superiority
    """Superiority of return a over return b."""
    steps_difference: Estimate | None
    """Mean of steps to the goal of a - those of b, a failure counting as the time limit; None without a limit."""
    simultaneous: Simultaneous
    paired: bool = True
    """True if both played the same episodes."""
    success_p: float | None = None
    """Exact two-sided p-value for equal success: McNemar's (1947), or without pairs that of `unconditional`; of several
    trainings, that of `crossed`; one of `any_number` of episodes holds for all of them. None if success is unknown."""
    wins: tuple[int, int] = (0, 0)
    """Numbers of episodes that a and that b won. Counts of several trainings are means over these."""
    both_won: int = 0
    """Number of pairs that both won; this and the next three are 0 without pairs, or if success is unknown."""
    only_a: int = 0
    only_b: int = 0
    neither: int = 0
    return_p: float | None = None
    """Two-sided p-value for equal returns in the mean; None where the possible returns are unknown."""
    steps_p: float | None = None
    """Two-sided p-value for equal steps to the goal in the mean; None without `steps_difference`."""
    crossed: CrossedDifference | None = None
    """Difference in success, if a or b is several trainings and success is known."""
    any_number: bool = False
    """True if all p-values and intervals hold at any number of episodes, so that earlier looks change nothing."""
    anytime: SuccessIntervals | None = None
    """Intervals of success in that case, if success is known."""

    @property
    def episodes(self) -> int:
        """Number of episodes of either policy, the smaller one."""
        return min(self.sample_sizes)

    @property
    def success_difference(self) -> Estimate | None:
        """Success rate of a minus that of b, with its 95 % interval; None if success is unknown."""
        return self.success_among(1)

    def success_among(self, num_comparisons: int) -> Estimate | None:
        """Return the difference in success with an interval that holds at once for so many pairs.

        Over trainings, and at any number of episodes, it holds for one pair, or for all of the comparison.
        """
        if (intervals := self.crossed or self.anytime) is not None:
            return intervals.estimate if num_comparisons == 1 else intervals.simultaneous
        if self.success_p is None:
            return None
        return self._difference_in_success(1 - UNCERTAINTY / num_comparisons)

    def _difference_in_success(self, confidence: float) -> Estimate:
        if self.paired:
            return mover(self.only_a, self.only_b, self.episodes, confidence)
        return newcombe(self.wins[0], self.sample_sizes[0], self.wins[1], self.sample_sizes[1], confidence)

    @property
    def p(self) -> float:
        """p-value for equal success, or that of the sign test if success is unknown."""
        return self.superiority.p if self.success_p is None else self.success_p

    @property
    def planning_share(self) -> float:
        """Share of the pairs that exactly one won, or without pairs, of the episodes that were won on both sides.

        With one more of either kind (Laplace).
        """
        if self.paired:
            return (self.only_a + self.only_b + 1) / (self.episodes + 2)
        return (sum(self.wins) + 1) / (sum(self.sample_sizes) + 2)

    def lead_of(self, policy: str) -> float:
        """Return the statistic that `p` tests, of one policy against the other.

        Its success minus the other's; if that is unknown, the share of episodes in which it has the higher return minus
        the share in which it has the lower one.
        """
        success = self.success_difference
        lead = success.value if success else 2 * self.superiority.probability.value - 1
        return lead if policy == self.a else -lead

    def equivalent(self, margin: float, num_comparisons: int = 1) -> bool:
        """Return True if success differs by less than `margin`.

        By two one-sided tests (Schuirmann 1987) at 5 % / `num_comparisons`.
        """
        if self.success_p is None:
            return False
        intervals, level = self.crossed or self.anytime, 1 - 2 * EQUIVALENCE / num_comparisons
        return within(intervals.at(level) if intervals else self._difference_in_success(level), margin)

    def reversed(self) -> "Difference":
        """Return policy b against policy a, by the same tests."""
        wide, higher = self.simultaneous, self.superiority
        return replace(
            self, a=self.b, b=self.a, sample_sizes=self.sample_sizes[::-1], wins=self.wins[::-1],
            only_a=self.only_b, only_b=self.only_a,
            return_difference=-self.return_difference,
            steps_difference=None if self.steps_difference is None else -self.steps_difference,
            superiority=replace(higher, probability=higher.probability.complement),
            crossed=None if self.crossed is None else -self.crossed,
            anytime=None if self.anytime is None else -self.anytime,
            simultaneous=Simultaneous(
                -wide.returns, wide.superiority.complement, None if wide.steps is None else -wide.steps
            ),
        )  # fmt: skip


def within(difference: Estimate, margin: float) -> bool:
    """Return True if the whole interval of a difference is smaller than `margin`."""
    low, high = difference.bounds
    return -margin < low and high < margin


def significant(difference: Estimate, p: float | None) -> bool:
    """Return True if a difference is significant by its p-value and by its interval."""
    low, high = difference.bounds
    return p is not None and p < SIGNIFICANT and (low > 0 or high < 0)


Pair = tuple[Array, Array]
"""Scores of two policies."""


@dataclass(frozen=True)
class Scores:
    """Scores of two policies, each (episodes,) or (trainings, episodes), of at least one episode."""

    success: Pair | None
    """None if it is unknown."""
    returns: Pair
    steps: Pair | None = None
    """Restricted steps to the goal; None without a time limit."""
    return_bounds: Bounds | None = None
    """Those of each policy's return; None if they are unknown."""
    time_limit: int | None = None


def difference_between(a: str, b: str, scores: Scores, num_comparisons: int = 1, *, paired: bool = True) -> Difference:
    """Compare two policies, or learners of several trainings each, on the same episodes, or on different ones.

    If they are `paired`, columns of both are the same episodes, in the same order. The simultaneous intervals hold for
    `num_comparisons` pairs.
    """
    wide, returns = 1 - UNCERTAINTY / num_comparisons, _tables(scores.returns)
    mean_returns = returns
    if not all(np.isfinite(sample).all() for sample in returns):  # a policy failed, at an unknown cost
        mean_returns = np.full_like(returns[0], math.nan), np.full_like(returns[1], math.nan)
    return_difference, return_simultaneous, return_p = _mean_difference(
        mean_returns, scores.return_bounds, wide, paired
    )
    steps_difference, steps_simultaneous, steps_p = None, None, None
    if scores.steps is not None and scores.time_limit is not None:
        bounds = 1.0, float(scores.time_limit)
        steps_difference, steps_simultaneous, steps_p = _mean_difference(_tables(scores.steps), bounds, wide, paired)
    higher, higher_simultaneous = _superiority(*returns, wide, paired)
    return Difference(
        a=a,
        b=b,
        sample_sizes=(returns[0].shape[1], returns[1].shape[1]),
        return_difference=return_difference,
        superiority=higher,
        steps_difference=steps_difference,
        return_p=return_p,
        steps_p=steps_p,
        simultaneous=Simultaneous(return_simultaneous, higher_simultaneous, steps_simultaneous),
        paired=paired,
        **({} if scores.success is None else _success(_tables(scores.success), num_comparisons, paired)),
    )


def _tables(scores: Pair) -> Pair:
    return np.atleast_2d(np.asarray(scores[0], dtype=float)), np.atleast_2d(np.asarray(scores[1], dtype=float))


def _success(success: Pair, num_comparisons: int, paired: bool) -> dict[str, Any]:
    """Return the fields of `Difference` that are about success."""
    result: dict[str, Any] = {}
    if max(map(len, success)) > 1:
        narrow, wide = 1 - 2 * EQUIVALENCE / num_comparisons, 1 - UNCERTAINTY / num_comparisons
        result["crossed"] = difference_over_trainings(*success, (0.0, 1.0), narrow, wide, paired)
    if paired:
        counts = counts_of_pairs(*success)
        result |= dict(zip(("both_won", "only_a", "only_b", "neither"), counts, strict=True))
        wins, p = (counts[0] + counts[1], counts[0] + counts[2]), mcnemar(*counts[1:3])
    else:
        first, second = (round(float(won.mean()) * won.shape[1]) for won in success)
        wins, p = (first, second), unconditional(first, success[0].shape[1], second, success[1].shape[1])
    return result | {"wins": wins, "success_p": result["crossed"].p if "crossed" in result else p}


def _mean_difference(
    scores: Pair, bounds: Bounds | None, confidence: float, paired: bool
) -> tuple[Estimate, Estimate, float | None]:
    """Return a mean difference with both intervals, and its p-value: all unknown if the possible scores are."""
    a, b = scores
    if max(len(a), len(b)) > 1:
        crossed = difference_over_trainings(a, b, bounds, simultaneous=confidence, paired=paired)
        return crossed.estimate, crossed.simultaneous, crossed.p
    if bounds is None:
        unknown = Estimate(float(a.mean() - b.mean()), None, None)
        return unknown, unknown, None
    if paired:
        difference = bounded_difference(a[0] - b[0], (bounds[0] - bounds[1], bounds[1] - bounds[0]), confidence)
        assert difference is not None
    else:
        difference = bounded_sum([a[0], b[0]], [1, -1], bounds, confidence)
    return difference.estimate, difference.simultaneous, difference.p


def _superiority(a: Array, b: Array, confidence: float, paired: bool) -> tuple[Superiority, Estimate]:
    """Return the superiority of a over b, and the same probability with an interval of another confidence."""
    if not paired or max(len(a), len(b)) > 1:
        return superiority_over_trainings(a, b, confidence, paired)
    simultaneous = bounded_mean((sign_of_difference(a[0], b[0]) + 1) / 2, (0.0, 1.0), confidence)
    assert simultaneous is not None
    return paired_superiority(a[0], b[0]), simultaneous
