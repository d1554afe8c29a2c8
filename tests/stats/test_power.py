"""The power of a verdict's tests, and the episodes that it takes."""

import itertools

import numpy as np
import pytest
from scipy import stats

from armctl.stats.difference import within
from armctl.stats.paired import mcnemar, mover
from armctl.stats.power import (
    detection_power,
    episodes_to_detect,
    episodes_to_show_equivalence,
    equivalence_power,
)
from armctl.study.sample_size import plan_comparison


def added_up(episodes, only_a, only_b, shown):
    """The probability of `shown`, over all numbers of episodes that only a and only b win."""
    counts = [(a, b) for a in range(episodes + 1) for b in range(episodes + 1 - a) if shown(a, b)]
    chances = [stats.multinomial.pmf((a, b, episodes - a - b), episodes, (only_a, only_b, 1 - only_a - only_b))
               for a, b in counts]  # fmt: skip
    return sum(chances)


@pytest.mark.parametrize("episodes", [3, 17, 30])
@pytest.mark.parametrize(
    ("difference", "discordant", "tests"), [(0.3, 0.3, 1), (0.3, 0.5, 1), (0.4, 0.6, 3), (0.5, 1.0, 1)]
)
def test_the_power_to_detect_is_that_of_mcnemars_exact_test(episodes, difference, discordant, tests):
    only_a, only_b = (discordant + difference) / 2, (discordant - difference) / 2
    exact = added_up(episodes, only_a, only_b, lambda a, b: a > b and tests * mcnemar(a, b) < 0.05)
    assert detection_power(episodes, difference, discordant, tests) == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize("episodes", [5, 7, 24, 41])
@pytest.mark.parametrize(
    ("margin", "discordant", "num_comparisons"),
    [(0.2, 0.0, 1), (0.3, 0.1, 1), (0.25, 0.4, 1), (0.4, 1.0, 2), (0.7, 0.4, 1)],
)
def test_the_power_to_show_equivalence_is_that_of_movers_interval(episodes, margin, discordant, num_comparisons):
    exact = added_up(
        episodes, discordant / 2, discordant / 2,
        lambda a, b: within(mover(a, b, episodes, 1 - 0.1 / num_comparisons), margin),
    )  # fmt: skip
    assert equivalence_power(episodes, margin, discordant, num_comparisons) == pytest.approx(exact, abs=1e-6)


GRID = [
    pytest.param(
        difference,
        share,
        power,
        tests,
        marks=pytest.mark.slow if share == 0.9 or (difference < 0.1 and tests != 3) else (),
    )
    for difference, share in ((0.02, 0.02), (0.02, 0.1), (0.1, 0.02), (0.1, 0.3), (0.05, 0.9))
    for power, tests in ((0.5, 1), (0.8, 3), (0.9, 18))
]


@pytest.mark.parametrize(("difference", "share", "power", "tests"), GRID)
def test_so_many_episodes_have_the_power_that_was_asked_for_and_one_less_has_not(difference, share, power, tests):
    needed = episodes_to_detect(difference, share, power, tests)
    at_least = max(share, difference)
    later = [detection_power(needed + more, difference, at_least, tests) for more in range(0, int(8 / at_least), 5)]
    assert min(later) >= power - 1e-4  # of numbers between those of the grid
    assert detection_power(needed - 1, difference, at_least, tests) < power
    only_a, only_b = (at_least + difference) / 2, (at_least - difference) / 2
    played = np.random.default_rng(0).multinomial(needed, (only_a, only_b, 1 - at_least), 4000)
    told = {(a, b): a > b and tests * mcnemar(a, b) < 0.05 for a, b in {(int(a), int(b)) for a, b, _ in played}}
    found = np.mean([told[int(a), int(b)] for a, b, _ in played])
    assert found == pytest.approx(later[0], abs=3 * 0.5 / 4000**0.5)


@pytest.mark.parametrize(("margin", "share", "power", "num_comparisons"), GRID)
def test_so_many_episodes_show_equivalence_as_often_as_was_asked_for(margin, share, power, num_comparisons):
    needed = episodes_to_show_equivalence(margin, share, power, num_comparisons)
    later = [equivalence_power(needed + more, margin, share, num_comparisons) for more in range(0, int(4 / margin), 7)]
    assert min(later) >= power - 1e-4  # of numbers between those of the grid
    assert equivalence_power(needed - 1, margin, share, num_comparisons) < power
    played = np.random.default_rng(0).multinomial(needed, (share / 2, share / 2, 1 - share), 2000)
    told = {
        (a, b): within(mover(a, b, needed, 1 - 0.1 / num_comparisons), margin)
        for a, b in {(int(a), int(b)) for a, b, _ in played}
    }
    found = np.mean([told[int(a), int(b)] for a, b, _ in played])
    assert found == pytest.approx(later[0], abs=3 * 0.5 / 2000**0.5)


def test_the_normal_approximation_was_not_enough():
    """44 episodes were to show equivalence within 10 points with a power of 0.8, and did with 0.5."""
    assert equivalence_power(44, 0.1, 0.02) == pytest.approx(0.496, abs=0.001)
    assert detection_power(155, 0.1, 0.2) == pytest.approx(0.762, abs=0.001)
    assert episodes_to_show_equivalence(0.1, 0.02) > 44
    assert episodes_to_detect(0.1, 0.2) > 155


def test_power_grows_with_the_difference_and_falls_with_the_tests():
    for few, many in itertools.pairwise((1, 3, 18)):
        assert detection_power(500, 0.03, 0.1, few) > detection_power(500, 0.03, 0.1, many)
        assert equivalence_power(1500, 0.03, 0.1, few) > equivalence_power(1500, 0.03, 0.1, many)
    for small, large in itertools.pairwise((0.01, 0.03, 0.06)):
        assert detection_power(500, small, 0.1) < detection_power(500, large, 0.1)
        assert equivalence_power(1500, small, 0.1) < equivalence_power(1500, large, 0.1)


@pytest.mark.slow
def test_a_plan_of_small_differences_is_exact_within_a_five_hundredth():
    needed = episodes_to_detect(0.002, 0.3)
    assert detection_power(needed, 0.002, 0.3) >= 0.8 > detection_power(round(needed * 0.996), 0.002, 0.3)


@pytest.mark.slow
def test_the_plan_tells_these_numbers():
    for record in plan_comparison(0.05, power=0.9, pairs=1).tables[0].records:
        possible = record["discordant"] >= 0.05
        assert record["episodes_to_detect"] == (
            episodes_to_detect(0.05, record["discordant"], 0.9, 3) if possible else None
        )
        assert record["episodes_to_show_equivalence"] == episodes_to_show_equivalence(0.05, record["discordant"], 0.9)
