"""Success of two policies on the same episodes: McNemar's test, and the interval of the difference."""

import math
from functools import lru_cache

import numpy as np

from armctl.core.arrays import Array
from armctl.stats.binomial import clopper_pearson, fair_coin_p
from armctl.stats.intervals import Bounds, Estimate


def mcnemar(only_a: int, only_b: int) -> float:
    """Return McNemar's exact two-sided p-value (1947) for equal success, from the episodes that only a or b won."""
    return fair_coin_p(only_a, only_a + only_b)


@lru_cache(maxsize=10_000)
def mover(only_a: float, only_b: float, episodes: int, confidence: float = 0.95) -> Estimate:
    """Return the difference in success of paired episodes, from the numbers that only a and only b won.

    Its limits are combined from Clopper and Pearson's of both shares, whose multinomial correlation is known (Zou
    and Donner, Statistics in Medicine 27, 2008). Where hardly anything was discordant, they miss on neither side in
    more than 2.5 % of comparisons, unlike Tango's score interval (up to 5 %).
    """
    a, b = only_a / episodes, only_b / episodes
    correlation = -math.sqrt(a * b / ((1 - a) * (1 - b))) if a * b else 0.0
    limits_a, limits_b = (clopper_pearson(count, episodes, confidence) for count in (only_a, only_b))
    return combined(a, limits_a, b, limits_b, correlation)


def combined(a: float, limits_a: Bounds, b: float, limits_b: Bounds, correlation: float = 0.0) -> Estimate:
    """Return the difference of two probabilities, with limits from those of each (MOVER)."""

    def distance(of_a: float, of_b: float) -> float:
        return math.sqrt(of_a**2 - 2 * correlation * of_a * of_b + of_b**2)

    low, high = a - b - distance(a - limits_a[0], limits_b[1] - b), a - b + distance(limits_a[1] - a, b - limits_b[0])
    return Estimate(a - b, max(low, -1.0), min(high, 1.0))


def counts_of_pairs(a: Array, b: Array) -> tuple[int, int, int, int]:
    """Return in how many episodes both won, only a, only b, and neither; means over trainings, rounded to their sum."""
    won, other = a[:, None], b
    shares = [float(share.mean()) for share in (won * other, won * (1 - other), (1 - won) * other)]
    ends = np.rint(np.cumsum([0.0, *shares, 1.0 - sum(shares)]) * won.shape[-1])
    both_won, only_a, only_b, neither = np.diff(ends).astype(int).tolist()
    return both_won, only_a, only_b, neither
