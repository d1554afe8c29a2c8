"""Two policies on the same episodes: difference in success, equivalence, and how many episodes it takes."""

import bisect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from armctl.evaluation.statistics import Array, Bounds, Estimate, Superiority, bounded_mean, paired_superiority

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
    """Exact two-sided p-value for equal success (McNemar 1947); None, with counts of 0, if success is unknown."""
    return_difference: Estimate
    """Mean of return a - return b."""
    superiority: Superiority
    """Of return a over return b."""
    steps_difference: Estimate | None
    """Mean of steps to the goal of a - those of b, a failure counting as the time limit; None without a limit."""

    @property
    def success_difference(self) -> Estimate | None:
        """Success rate of a minus that of b, with Tango's 95 % interval; None if success is unknown."""
        return None if self.mcnemar_p is None else tango(self.only_a, self.only_b, self.episodes)

    def equivalent(self, margin: float) -> bool:
        """Whether success differs by less than `margin`: two one-sided tests at 5 % (Schuirmann 1987), after Tango."""
        if self.mcnemar_p is None:
            return False
        found = tango(self.only_a, self.only_b, self.episodes, 0.90)
        assert found.low is not None
        assert found.high is not None
        return -margin < found.low and found.high < margin


def mcnemar(only_a: int, only_b: int) -> float:
    """Exact two-sided p-value for equal success, from how many episodes only a and only b won (McNemar 1947)."""
    return float(stats.binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


@lru_cache(maxsize=10_000)
def tango(only_a: float, only_b: float, episodes: int, confidence: float = 0.95) -> Estimate:
    """Difference in success of paired episodes with Tango's score interval (Statistics in Medicine 17, 1998)."""
    difference = (only_a - only_b) / episodes
    z = float(stats.norm.ppf((1 + confidence) / 2))

    def score(delta: float) -> float:
        b = (2 * episodes - only_a + only_b) * delta - only_a - only_b
        root = math.sqrt(max(0.0, b * b + 8 * episodes * only_b * delta * (1 - delta)))
        variance = episodes * (2 * (root - b) / (4 * episodes) + delta * (1 - delta))
        distance = only_a - only_b - episodes * delta
        return distance / math.sqrt(variance) if variance > 0 else math.copysign(math.inf, distance)

    def limit(end: float, z: float) -> float:
        inside = difference + 1e-9 * (end - difference)
        if abs(difference - end) < 1e-12 or (score(inside) - z) * (score(end) - z) > 0:
            return end
        return float(optimize.brentq(lambda delta: score(delta) - z, inside, end))

    return Estimate(difference, limit(-1 + 1e-12, z), limit(1 - 1e-12, -z))


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values for one claim of several, corrected for their number (Holm 1979), in the same order."""
    order = np.argsort(p_values)
    corrected = np.asarray(p_values, dtype=float)[order] * np.arange(len(p_values), 0, -1)
    result = np.empty(len(p_values))
    result[order] = np.minimum(np.maximum.accumulate(corrected), 1.0)
    return [float(p) for p in result]


def episodes_to_detect(difference: float, discordant: float, power: float = 0.8) -> int:
    """How many episodes show a difference in success, with a two-sided test at 5 % (Connor, Biometrics 43, 1987).

    `discordant` is the share of episodes that exactly one of the two wins; it is at least the difference.
    """
    discordant = max(discordant, difference)
    z_level, z_power = (float(stats.norm.ppf(one)) for one in (0.975, power))
    spread = z_level * math.sqrt(discordant) + z_power * math.sqrt(discordant - difference**2)
    return math.ceil((spread / difference) ** 2)


def episodes_to_show_equivalence(margin: float, discordant: float, power: float = 0.8) -> int:
    """How many episodes show that two policies that are equally good differ by less than `margin` (two tests at 5 %).

    By Tango's interval, when as many episodes are discordant as is expected, and one of the two wins so many more of
    them as happens with a probability of `power` at most.
    """
    z_power = float(stats.norm.ppf((1 + power) / 2))

    def shown(episodes: int) -> bool:
        count = discordant * episodes
        ahead = z_power * math.sqrt(count)
        found = tango((count + ahead) / 2, max(0.0, count - ahead) / 2, episodes, 0.90)
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
    return_difference = bounded_mean(returns[0] - returns[1], (-most, most))
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
        _steps_difference(steps, time_limit),
    )


def _steps_difference(steps: tuple[Array, Array] | None, time_limit: int | None) -> Estimate | None:
    if steps is None or time_limit is None:
        return None
    return bounded_mean(steps[0] - steps[1], (1.0 - time_limit, time_limit - 1.0))
