"""Numbers of episodes that show a difference in success, or equivalence, by the exact power of a verdict's tests."""

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import scipy
from numpy.typing import NDArray

from armctl.stats.binomial import cdf, likely_counts, probability, quantile
from armctl.stats.difference import EQUIVALENCE, SIGNIFICANT
from armctl.stats.unpaired import unpaired_power

TEETH, STEPS = 4, 20
"""Periods of the saw-tooth that are examined, before and after a number of episodes with enough power, and numbers of
episodes in each."""
UNPAIRED_PERIOD = 2.0
"""Episodes in a period where the saw-teeth of many numbers of wins overlap."""
NEAR = 1.1
"""Factor between numbers of episodes that are tried around a known start."""
COARSEST = 500
"""Part of a number of episodes that makes no difference to a plan."""


@cache
def episodes_to_detect(difference: float, share: float, power: float = 0.8, tests: int = 1, paired: bool = True) -> int:
    """Return how many episodes show a difference in success, with McNemar's exact test.

    `share` is that of the episodes that exactly one of the two wins; it is at least the difference. If policies are not
    `paired`, the test is `unconditional`, and `share` is the mean of their success rates; each plays the number of
    episodes. With several `tests`, that of success is at 5 % / `tests` (Bonferroni); Holm's correction needs no more.
    The power of an exact test is a saw-tooth: the number is the least one from which on it is at least `power`, as far
    as the next 8 discordant episodes show (8 episodes without pairs), or within 1 / 500 of that.
    """
    if not paired:
        start = _normal_episodes(difference, share, power, SIGNIFICANT / tests)
        return _min_episodes(
            lambda n: detection_power(n, difference, share, tests, paired), power, UNPAIRED_PERIOD, start
        )
    share = max(share, difference)
    return _min_episodes(lambda n: detection_power(n, difference, share, tests), power, 2 / share)


@cache
def episodes_to_show_equivalence(
    margin: float, share: float, power: float = 0.8, num_comparisons: int = 1, paired: bool = True
) -> int:
    """Return how many episodes show that two equally good policies differ by less than `margin`.

    With the two one-sided tests of the verdict at 5 % / `num_comparisons`, by `mover`'s interval, or by `newcombe`'s if
    they are not `paired`. As in `episodes_to_detect`, the number is the least one from which on the power is enough, as
    far as the next 4 / `margin` episodes show.
    """
    return _min_episodes(lambda n: equivalence_power(n, margin, share, num_comparisons, paired), power, 1 / margin)


def _normal_episodes(difference: float, share: float, power: float, level: float) -> int:
    """Return about how many episodes show a difference without pairs: if means were normal."""
    quantiles = float(scipy.special.ndtri(1 - level / 2) + max(scipy.special.ndtri(power), 0.0))
    variance = sum(rate * (1 - rate) for rate in rates_around(share, difference))
    return max(2, round(quantiles**2 * variance / difference**2))


def rates_around(share: float, difference: float) -> tuple[float, float]:
    """Return success rates that differ by so much, with the mean `share` if that is possible, the better one first."""
    better = min(max(share + difference / 2, difference), 1.0)
    return better, better - difference


def detection_power(episodes: int, difference: float, share: float, tests: int = 1, paired: bool = True) -> float:
    """Return the probability that the exact test at 5 % / `tests` shows the better policy to be better."""
    if not paired:
        return unpaired_power(*rates_around(share, difference), episodes, SIGNIFICANT / tests)
    discordant, counts = share, likely_counts(episodes, share)
    max_losses = quantile(SIGNIFICANT / tests / 2, counts, 0.5)  # which are as likely as so many wins
    p_win = min(1.0, (discordant + difference) / (2 * discordant))
    return float(probability(counts, episodes, discordant) @ cdf(max_losses, counts, 1 - p_win))


def equivalence_power(
    episodes: int, margin: float, share: float, num_comparisons: int = 1, paired: bool = True
) -> float:
    """Return the probability that equally good policies are shown to differ by less than `margin`.

    The counts are of episodes that only a, and that only b wins; of all that they win if they are not `paired`.
    """
    share, level = share / 2 if paired else share, EQUIVALENCE / num_comparisons
    counts = likely_counts(episodes, share)
    rates, rest = counts / episodes, episodes - counts
    beneath = rates - np.where(counts > 0, scipy.special.betaincinv(np.maximum(counts, 1), rest + 1, level), 0.0)
    above = np.where(rest > 0, scipy.special.betainccinv(counts + 1, np.maximum(rest, 1), level), 1.0) - rates
    odds = np.sqrt(rates / np.maximum(1 - rates, 1e-300)) * paired  # without pairs, both are independent

    def within(a: NDArray[np.intp], b: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return True where the interval's upper limit is below the margin."""
        covariance = odds[a] * odds[b] * above[a] * beneath[b]
        distance = np.sqrt(above[a] ** 2 + 2 * covariance + beneath[b] ** 2)
        return np.asarray(rates[a] - rates[b] + distance < margin)

    first = _first(within, len(counts))  # of b's wins, for each number of a's
    last = np.searchsorted(first, np.arange(len(counts)), side="right") - 1  # the same limit with a and b exchanged
    equivalent = first <= last
    a, low, high = counts[equivalent], counts[first[equivalent]], counts[last[equivalent]]
    remaining, given_a = (episodes - a, share / (1 - share)) if paired else (episodes, share)
    inside = cdf(high, remaining, given_a) - cdf(low - 1, remaining, given_a)
    return float(probability(a, episodes, share) @ inside)


def _first(holds: Callable[[NDArray[np.intp], NDArray[np.intp]], NDArray[np.bool_]], n: int) -> NDArray[np.intp]:
    """Return, for each of n rows, the first of n columns from which on something holds; n if there is none."""
    rows = np.arange(n)
    low, high = np.zeros(n, dtype=np.intp), np.full(n, n, dtype=np.intp)
    while (open_ := low < high).any():
        middle = (low + high) // 2
        holding = holds(rows, np.minimum(middle, n - 1))
        high = np.where(open_ & holding, middle, high)
        low = np.where(open_ & ~holding, middle + 1, low)
    return low


def _min_episodes(power_at: Callable[[int], float], power: float, period: float, start: int = 1) -> int:
    """Return the least number of episodes from which on the power is enough, over some periods of the saw-tooth.

    A crossing is found by bisection, beginning near `start` if that is known. Around it, the last number that is not
    enough is looked for on a grid, and then between two of its numbers.
    """
    power_of = cache(power_at)
    factor = 2 if start == 1 else NEAR
    high = start
    while power_of(high) < power:
        high = math.ceil(high * factor)
    low = int(high / factor)
    while low and power_of(low) >= power:
        high, low = low, int(low / factor)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power_of(middle) >= power else (middle, high)
    stride = max(1, round(period / STEPS), high // COARSEST) | 1  # odd: where all are discordant, parity matters
    window = max(round(TEETH * period), stride)
    grid = range(max(1, high - window), high + window + 1, stride)
    last = next((n for n in reversed(grid) if power_of(n) < power), low)
    if stride > STEPS:
        return last + stride
    return 1 + next((n for n in reversed(range(last + 1, last + stride)) if power_of(n) < power), last)
