"""Tests and intervals of pairs of episodes that hold at any number of episodes, so that anybody may stop early.

A gambler bets against a supposed mean on each next value. If the supposition is true, the capital exceeds 1 / p at any
time with a probability of at most p (Ville 1939). The confidence sequence has all means against which the capital has
never been that large (Waudby-Smith and Ramdas, Journal of the Royal Statistical Society B 86, 2024). The bet is a
fixed share of what can be bet; the capital is a mixture over shares. For values of -1, 0 and 1 and a mean of 0, only
discordant episodes count, as tosses of a fair coin, and the capital is Robbins' (1970) beta-binomial mixture.

`benchmarks/sequential.py` simulates errors, coverage and power, by which `PRIOR` was chosen.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import scipy

from armctl.core.arrays import Array
from armctl.stats.difference import UNCERTAINTY, Difference, Pair, Scores, Simultaneous, SuccessIntervals
from armctl.stats.intervals import Bounds, Estimate, MeanDifference, Superiority, sign_of_difference
from armctl.stats.paired import counts_of_pairs

PRIOR = 0.25
"""Parameter of the symmetric beta distribution of the share that a policy wins of the discordant episodes.

Below 1/2, one-sided outcomes are likely: where both policies win nearly always, few episodes are discordant."""
NODES = 24
"""Shares of the mixture, which are those of a Gaussian quadrature."""
BLOCK, GROWTH = 10, 0.1
"""Episodes of the first blocks, and the share of what was played that later ones have.

A look costs the time to judge all episodes. With these, a comparison plays some 4 % more episodes than if each were
followed by a look (`--table blocks`)."""
SMALLEST_MEAN, TOLERANCE = 1e-12, 1e-9
"""Least mean, as a share of the possible range, that is tested, and the error of a limit."""


def block_ends(max_episodes: int) -> list[int]:
    """Return the numbers of episodes after which a comparison of at most so many is judged; these are the last."""
    ends = [min(max_episodes, BLOCK)]
    while ends[-1] < max_episodes:
        ends.append(min(max_episodes, ends[-1] + max(BLOCK, round(GROWTH * ends[-1]))))
    return ends


@lru_cache(maxsize=1)
def _bets() -> tuple[Array, Array]:
    """Return shares that are bet and the logarithms of their weights, (`NODES`,)."""
    nodes, weights = scipy.special.roots_jacobi(2 * NODES, PRIOR - 1, PRIOR - 1)
    positive = nodes > 0
    return nodes[positive], np.log(weights[positive] / weights[positive].sum())


@dataclass(frozen=True)
class _Gambler:
    """Bets on values (k,), as shares of the possible range, that they are above a supposed mean."""

    shares: Array

    def largest_capital(self, mean: float) -> float:
        """Return the logarithm of the largest capital of any time. It falls as the supposed `mean` rises."""
        from armctl.kernels.betting import largest_capital  # what compiles it takes 0.2 s to load

        return float(largest_capital(*_bets(), self.shares, mean))

    def lower_limit(self, tail: float) -> float:
        """Return the least mean that was never refuted at the level `tail`."""
        threshold = -math.log(tail)

        def excess(mean: float) -> float:
            return self.largest_capital(mean) - threshold

        deviation = float(self.shares.std() * np.sqrt(2 * threshold / len(self.shares)))
        high, step = float(self.shares.mean()), deviation + TOLERANCE
        if high > SMALLEST_MEAN and excess(high) > 0:
            high, low = 1.0, high
        else:
            while (low := max(high - step, SMALLEST_MEAN)) > SMALLEST_MEAN and excess(low) < 0:
                high, step = low, 2 * step
        if low == SMALLEST_MEAN and (high <= SMALLEST_MEAN or excess(low) < 0):
            return 0.0
        return float(scipy.optimize.brentq(excess, low, high, xtol=TOLERANCE))


@dataclass(frozen=True)
class ConfidenceSequence:
    """Mean of values (k,) that came one after the other and cannot lie outside `bounds`; k is at least 1.

    What it concludes from the first k values holds for all k at once.
    """

    values: Array
    bounds: Bounds
    _limits: dict[float, Bounds] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def _gamblers(self) -> tuple[_Gambler, _Gambler]:
        """Those who bet on values above a mean, and on values below it."""
        low, high = self.bounds
        shares = np.clip((self.values - low) / (high - low), 0.0, 1.0)
        return _Gambler(shares), _Gambler(1.0 - shares)

    def estimate(self, confidence: float = 0.95) -> Estimate:
        """Return the mean and the intersection of all intervals so far, which holds at any time."""
        if confidence not in self._limits:
            above, below = (gambler.lower_limit((1 - confidence) / 2) for gambler in self._gamblers)
            span = self.bounds[1] - self.bounds[0]
            self._limits[confidence] = self.bounds[0] + span * above, self.bounds[1] - span * below
        value, (low, high) = float(self.values.mean()), self._limits[confidence]
        return Estimate(value, min(low, value), max(high, value))

    def intervals(self, wide: float = 0.95) -> SuccessIntervals:
        """Return the mean with its intervals of 95 %, of the confidence `wide`, and of any other."""
        return SuccessIntervals(self.estimate(), self.estimate(wide)).by(self.estimate)

    def mean_difference(self, wide: float = 0.95) -> MeanDifference:
        """Return the mean with its intervals of 95 % and of the confidence `wide`, and its p-value."""
        return MeanDifference(self.estimate(), self.estimate(wide), self.p())

    def p(self) -> float:
        """Return the two-sided p-value for a mean of 0, from the largest capital of whoever bets on the present sign.

        It is below 5 % where the 95 % interval does not contain 0.
        """
        value, zero = self.values.mean(), -self.bounds[0] / (self.bounds[1] - self.bounds[0])
        if value == 0:
            return 1.0
        above, below = self._gamblers
        largest = above.largest_capital(zero) if value > 0 else below.largest_capital(1 - zero)
        return float(min(1.0, 2 * np.exp(-largest)))


def sequential_difference(a: str, b: str, scores: Scores, num_comparisons: int = 1) -> Difference:
    """Compare two policies as `difference_between` does, in the order of their episodes, at any number of them.

    The simultaneous intervals hold for `num_comparisons` pairs (Bonferroni). p-values hold when a
    comparison stops, so that Holm's correction of several applies to them as to all others.
    """
    wide = 1 - UNCERTAINTY / num_comparisons
    return_difference, wide_returns, return_p = _mean_difference(scores.returns, scores.return_bounds, wide)
    steps_difference, wide_steps, steps_p = None, None, None
    if scores.steps is not None and scores.time_limit is not None:
        bounds = 1.0, float(scores.time_limit)
        steps_difference, wide_steps, steps_p = _mean_difference(scores.steps, bounds, wide)
    higher = ConfidenceSequence(sign_of_difference(*scores.returns).ravel(), (-1.0, 1.0))
    success: dict[str, Any] = {}
    if scores.success is not None:
        won, other = (np.atleast_2d(np.asarray(success, dtype=float)) for success in scores.success)
        counts = counts_of_pairs(won, other)
        gains = ConfidenceSequence((won - other)[0], (-1.0, 1.0))
        success = {
            "success_p": gains.p(),
            "anytime": gains.intervals(wide),
            "wins": (int(won.sum()), int(other.sum())),
            **dict(zip(("both_won", "only_a", "only_b", "neither"), counts, strict=True)),
        }
    return Difference(
        a=a,
        b=b,
        sample_sizes=(len(higher.values), len(higher.values)),
        return_difference=return_difference,
        superiority=Superiority(_share(higher.estimate()), higher.p()),
        steps_difference=steps_difference,
        return_p=return_p,
        steps_p=steps_p,
        simultaneous=Simultaneous(wide_returns, _share(higher.estimate(wide)), wide_steps),
        any_number=True,
        **success,
    )


def _mean_difference(scores: Pair, bounds: Bounds | None, wide: float) -> tuple[Estimate, Estimate, float | None]:
    """Return a mean difference with both intervals, and its p-value: unknown if scores, or what they can be, are."""
    a, b = (np.asarray(score, dtype=float).ravel() for score in scores)
    failed = ~(np.isfinite(a) & np.isfinite(b))
    gains = np.where(failed, np.nan, a) - np.where(failed, np.nan, b)
    if bounds is None or failed.any():
        unknown = Estimate(float(gains.mean()), None, None)
        return unknown, unknown, None
    sequence = ConfidenceSequence(gains, (bounds[0] - bounds[1], bounds[1] - bounds[0]))
    return sequence.estimate(), sequence.estimate(wide), sequence.p()


def _share(signs: Estimate) -> Estimate:
    """Return the probability that is one half more than half a mean sign."""
    low, high = signs.bounds
    return Estimate((1 + signs.value) / 2, (1 + low) / 2, (1 + high) / 2)
