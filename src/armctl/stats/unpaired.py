"""Success of two policies on different episodes: an exact test, its power, and the interval of the difference.

The test is unconditional (Barnard, Biometrika 34, 1947): its p-value is the largest that any common success rate gives
that the episodes leave possible (Berger and Boos, JASA 89, 1994). Outcomes are ordered by the difference of Anscombe's
angles (Biometrika 35, 1948). With as many episodes on both sides, that order is about that of Barnard's pooled
difference, which finds nothing where numbers differ much: with 10 and 100 episodes, it shows a policy of 50 % to be
worse than one of 95 % with a power of 19 %, and angles with 90 %. Fisher's conditional test has 84 %, and Boschloo's,
whose order is Fisher's p-value, takes half a minute for 1,000 episodes each.
"""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import scipy

from armctl.core.arrays import Array
from armctl.stats.binomial import cdf, clopper_pearson, likely_counts, probability
from armctl.stats.intervals import Bounds, Estimate
from armctl.stats.paired import combined

TIE = 1e-7
"""Difference in wins below which two outcomes are equally extreme."""
IMPOSSIBLE = 5e-10
"""Probability of episodes that exclude the common success rate. It is added to the p-value of either side."""
RATES = 65
"""Number of success rates that are tried, before others near the worst of them."""
HALVINGS = 24
"""Number of steps in which a critical lead is found."""
WIDTH, FEW = 7.0, 25
"""Standard deviations, and counts in addition, on either side of the mean beyond which counts are left out."""


@lru_cache(maxsize=10_000)
def unconditional(wins_a: int, episodes_a: int, wins_b: int, episodes_b: int) -> float:
    """Return the exact two-sided p-value for equal success: twice that of the side on which the difference is."""
    lead = float(_angle(wins_a, episodes_a) - _angle(wins_b, episodes_b))
    sizes = (episodes_a, episodes_b) if lead > 0 else (episodes_b, episodes_a)
    low, high = _possible(wins_a + wins_b, episodes_a + episodes_b)
    logits = np.linspace(low, high, RATES)
    p = _tail(*sizes, logits)(np.array(abs(lead)))
    spacing, worst = (high - low) / (RATES - 1), np.argsort(p)[-3:]
    near = np.clip([logits[i] + np.linspace(-spacing, spacing, 17) for i in worst], low, high).ravel()
    return min(1.0, 2 * (float(max(p.max(), _tail(*sizes, near)(np.array(abs(lead))).max())) + IMPOSSIBLE))


@lru_cache(maxsize=10_000)
def newcombe(wins_a: int, episodes_a: int, wins_b: int, episodes_b: int, confidence: float = 0.95) -> Estimate:
    """Return the difference in success with Newcombe's interval (Statistics in Medicine 17, 1998, method 10).

    Its limits are combined from Clopper and Pearson's of both rates, as `mover` does for pairs, in place of Wilson's,
    which miss too often where hardly anything fails. They are a little wide. So where the test is significant at the
    same level, the interval ends at 0 if it does not before.
    """
    limits_a, limits_b = (
        clopper_pearson(wins_a, episodes_a, confidence),
        clopper_pearson(wins_b, episodes_b, confidence),
    )
    difference = combined(wins_a / episodes_a, limits_a, wins_b / episodes_b, limits_b)
    if unconditional(wins_a, episodes_a, wins_b, episodes_b) >= 1 - confidence:
        return difference
    low, high = difference.bounds
    return Estimate(difference.value, *((max(low, 0.0), high) if difference.value > 0 else (low, min(high, 0.0))))


def unpaired_power(better: float, worse: float, episodes: int, level: float) -> float:
    """Return the probability that the test, two-sided at `level`, shows the better of two policies to be better.

    Both play so many episodes.
    """
    wins, losing = likely_counts(episodes, better), likely_counts(episodes, worse)
    first, last = int(wins[0] + losing[0]), int(wins[-1] + losing[-1])
    leads = _critical_leads(first, last, episodes, level / 2 - IMPOSSIBLE)
    low, high = np.full(len(wins), losing[0] - 1), np.full(len(wins), losing[-1])  # wins of the worse that show it
    while (low < high).any():
        middle = np.ceil((low + high) / 2)
        lead = _angle(wins, episodes) - _angle(middle.clip(0), episodes)
        significant = lead >= leads[(wins + middle - first).astype(int).clip(0)] - 1e-12
        low, high = np.where(significant, middle, low), np.where(significant, high, middle - 1)
    return float(probability(wins, episodes, better) @ cdf(low, episodes, worse))


def _critical_leads(first: int, last: int, episodes: int, level: float) -> Array:
    """Return the least lead that is significant, for each number of wins of both together from `first` to `last`."""
    totals = np.unique(np.linspace(first, last, min(last - first + 1, RATES)).round())
    ranges = np.array([_possible(int(total), 2 * episodes) for total in totals])
    logits = np.linspace(ranges.min(), ranges.max(), RATES)
    usual = float(scipy.special.ndtri(1 - level)) * (0.5 / episodes) ** 0.5
    low, high = np.zeros(RATES), np.full(RATES, min(4 * usual, np.pi / 2))
    tail = _tail(episodes, episodes, logits)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        above = tail(middle) > level
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    within = (logits >= ranges[:, :1] - 1e-9) & (logits <= ranges[:, 1:] + 1e-9)
    largest = np.where(within, high, 0.0).max(axis=1)
    return np.asarray(largest[np.searchsorted(totals, np.arange(first, last + 1)).clip(0, len(totals) - 1)])


def _possible(wins: int, episodes: int) -> Bounds:
    """Return the least and the largest success rate that so many wins leave possible, as logits."""
    low, high = clopper_pearson(wins, episodes, 1 - IMPOSSIBLE)
    end = np.log(100.0 * episodes)
    limits = scipy.special.logit([low, high]).clip(-end, end)
    return float(limits[0]), float(limits[1])


def _angle(wins: Array | int, episodes: int) -> Array:
    return np.asarray(np.arcsin(np.sqrt((wins + 3 / 8) / (episodes + 3 / 4))))


def _tail(episodes_a: int, episodes_b: int, logits: Array) -> Callable[[Array], Array]:
    """Return the function of leads, in angle, that is the probability of each at one of some success rates of both."""
    rates = scipy.special.expit(logits)[:, None]
    _, wins = _likely_wins(episodes_a, rates)
    first_b, wins_b = _likely_wins(episodes_b, rates)
    probabilities, angles = probability(wins, episodes_a, rates), _angle(wins, episodes_a)
    at_most = np.pad(cdf(wins_b, episodes_b, rates), ((0, 0), (1, 0)))

    def tail(leads: Array) -> Array:
        angle = angles - np.reshape(leads, (-1, 1))
        losing = np.floor((episodes_b + 3 / 4) * np.sin(np.maximum(angle, 0.0)) ** 2 - 3 / 8 + TIE)
        places = np.where(angle < 0, 0, losing - first_b + 1).clip(0, wins_b.shape[1]).astype(int)
        return np.asarray((probabilities * np.take_along_axis(at_most, places, axis=1)).sum(axis=1))

    return tail


def _likely_wins(episodes: int, rates: Array) -> tuple[Array, Array]:
    """Return the first (r, 1), and all (r, k), of the numbers of wins that are likely at success rates (r, 1)."""
    half = WIDTH * np.sqrt(episodes * rates * (1 - rates)) + FEW
    width = min(episodes + 1, int(2 * half.max()) + 2)
    first = np.floor(episodes * rates - half).clip(0, episodes + 1 - width)
    return first, first + np.arange(float(width))
