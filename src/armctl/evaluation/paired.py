"""Two policies on the same episodes: difference in success, equivalence, and how many episodes it takes."""

import bisect
import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from armctl.evaluation.statistics import (
    Array,
    Bounds,
    Estimate,
    Superiority,
    bounded_difference,
    bounded_mean,
    paired_superiority,
)
from armctl.evaluation.trainings import CrossedDifference, difference_over_trainings

EQUIVALENCE = 0.05
"""Level of each of the two tests that show equivalence."""
SIGNIFICANT = 0.05
"""Largest p-value of a difference that is told."""
MARGIN = 0.02
"""Largest difference in success of policies that count as equivalent, unless another one is given."""


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
    """Mean of return a - return b."""
    superiority: Superiority
    """Of return a over return b."""
    steps_difference: Estimate | None
    """Mean of steps to the goal of a - those of b, a failure counting as the time limit; None without a limit."""
    return_p: float | None = None
    """Two-sided p-value for equal returns in the mean; None in results of older versions."""
    crossed: CrossedDifference | None = None
    """In success, if a or b is several trainings and success is known."""

    @property
    def success_difference(self) -> Estimate | None:
        """Success rate of a minus that of b, with its 95 % interval; None if success is unknown."""
        if self.crossed is not None:
            return self.crossed.estimate
        return None if self.mcnemar_p is None else mover(self.only_a, self.only_b, self.episodes)

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


def corrected(pairs: Sequence[PairedDifference], baseline: str | None = None) -> list[float]:
    """The p-value of each pair, of equal success, or of equal chances for the higher return, after Holm's correction.

    With a `baseline`, the pairs against it are a family of their own; otherwise, and for all others, it is all pairs.
    """
    p = [pair.superiority.p if pair.mcnemar_p is None else pair.mcnemar_p for pair in pairs]
    own = [i for i, pair in enumerate(pairs) if baseline in (pair.a, pair.b)]
    return list((dict(enumerate(holm(p))) | dict(zip(own, holm([p[i] for i in own]), strict=True))).values())


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


def episodes_to_detect(difference: float, discordant: float, power: float = 0.8, pairs: int = 1) -> int:
    """How many episodes show a difference in success, with a two-sided test at 5 % (Connor, Biometrics 43, 1987).

    `discordant` is the share of episodes that exactly one of the two wins; it is at least the difference. With several
    `pairs`, the test is at 5 % / `pairs` (Bonferroni); Holm's correction needs no more.
    """
    discordant = max(discordant, difference)
    z_level, z_power = (float(stats.norm.ppf(one)) for one in (1 - 0.025 / pairs, power))
    spread = z_level * math.sqrt(discordant) + z_power * math.sqrt(discordant - difference**2)
    return math.ceil((spread / difference) ** 2)


def episodes_to_show_equivalence(margin: float, discordant: float, power: float = 0.8, claims: int = 1) -> int:
    """How many episodes show that two equally good policies differ by less than `margin` (two tests at 5 % / `claims`).

    When as many episodes are discordant as is expected, and one of the two wins so many more of them as happens with a
    probability of `power` at most.
    """
    z_power = float(stats.norm.ppf((1 + power) / 2))

    def shown(episodes: int) -> bool:
        count = discordant * episodes
        ahead = z_power * math.sqrt(count)
        least = max(0.0, count - ahead) / 2
        found = mover(min(count - least, episodes), least, episodes, 1 - 2 * EQUIVALENCE / claims)
        return found.high is not None and found.high < margin

    return _least(shown)


def _least(holds: Callable[[int], bool]) -> int:
    """The least number for which something holds that holds for all larger ones."""
    high = 1
    while not holds(high):
        high *= 2
    return 1 + bisect.bisect_left(range(1, high + 1), True, key=holds)


def paired_difference(
    a: str,
    b: str,
    success: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None,
    returns: tuple[Array, Array],
    steps: tuple[Array, Array] | None,
    return_bounds: Bounds,
    time_limit: int | None = None,
) -> PairedDifference:
    """Compare two policies. The i-th entries (k,) of both belong to the same episode; k is at least 1.

    `success` is None if it is unknown, `steps` are the restricted steps to the goal. `return_bounds` are those of each
    policy's return.
    """
    k = len(returns[0])
    success_a, success_b = success or (np.zeros(k, dtype=bool), np.zeros(k, dtype=bool))
    both = success_a & success_b
    only_a, only_b = int((success_a & ~success_b).sum()), int((success_b & ~success_a).sum())
    most = return_bounds[1] - return_bounds[0]
    gained = bounded_difference(returns[0] - returns[1], (-most, most))
    assert gained is not None
    return PairedDifference(
        a,
        b,
        len(both),
        int(both.sum()),
        only_a,
        only_b,
        0 if success is None else int((~success_a & ~success_b).sum()),
        None if success is None else mcnemar(only_a, only_b),
        gained[0],
        paired_superiority(*returns),
        _steps_difference(steps, time_limit),
        gained[1],
    )


def _steps_difference(steps: tuple[Array, Array] | None, time_limit: int | None) -> Estimate | None:
    if steps is None or time_limit is None:
        return None
    return bounded_mean(steps[0] - steps[1], (1.0 - time_limit, time_limit - 1.0))


def difference_of_groups(
    a: str,
    b: str,
    success: tuple[Array, Array] | None,
    returns: tuple[Array, Array],
    steps: tuple[Array, Array] | None,
    return_bounds: Bounds,
    time_limit: int | None = None,
    claims: int = 1,
) -> PairedDifference:
    """Compare two learners, at least one of which is several trainings.

    As `paired_difference`, for arrays of shape (trainings, episodes), of which a learner has one row or more. `claims`
    is for how many pairs equivalence may be claimed.
    """
    earned = difference_over_trainings(*returns, return_bounds)
    probability = _superiority_of_groups(*returns)
    late = None if steps is None or time_limit is None else difference_over_trainings(*steps, (1.0, float(time_limit)))
    crossed, both, only_a, only_b, neither = None, 0, 0, 0, 0
    if success is not None:
        crossed = difference_over_trainings(*success, (0.0, 1.0), 1 - 2 * EQUIVALENCE / claims)
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
        probability,
        late.estimate if late else None,
        earned.p,
        crossed,
    )


def _superiority_of_groups(a: Array, b: Array) -> Superiority:
    """For returns a (k, n) and b (m, n): the sum of what depends on a's training, and on b's."""
    ahead = (np.sign(a[:, None] - b) + 1) / 2
    of_b = ahead.mean() - ahead.mean(axis=0) if len(b) > 1 else np.zeros_like(b)
    found = difference_over_trainings(ahead.mean(axis=1) - 0.5, of_b, (-0.5, 0.5))
    limits = [None if one is None else float(np.clip(one + 0.5, 0, 1)) for one in dataclasses.astuple(found.estimate)]
    assert limits[0] is not None
    return Superiority(Estimate(limits[0], limits[1], limits[2]), found.p)
