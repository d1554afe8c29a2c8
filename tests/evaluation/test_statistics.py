import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.evaluation.statistics import (
    Estimate,
    interquartile_mean,
    mean,
    mean_over_trainings,
    median,
    paired_difference,
    paired_superiority,
    performance_profile,
    performance_ratios,
    success_rate,
    superiority,
)


@pytest.mark.parametrize(
    ("wins", "episodes", "low", "high"),
    # Newcombe (1998), "Two-sided confidence intervals for the single proportion", table I, method 3.
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_interval_against_newcombe(wins, episodes, low, high):
    estimate = success_rate(np.arange(episodes) < wins)
    assert estimate.value == pytest.approx(wins / episodes)
    assert (estimate.low, estimate.high) == pytest.approx((low, high), abs=5e-5)


@given(st.lists(st.booleans(), min_size=1, max_size=200))
def test_interval_holds_the_rate(successes):
    estimate = success_rate(np.array(successes))
    assert -1e-12 <= estimate.low <= estimate.value + 1e-12
    assert estimate.value - 1e-12 <= estimate.high <= 1 + 1e-12


def test_nothing_can_be_said_of_nothing():
    assert success_rate(np.array([], dtype=bool)) is None
    assert mean(np.array([])) is None


def test_mean_has_students_interval():
    # Student (1908), "The probable error of a mean": additional hours of sleep, t = 4.06 with 9 degrees of freedom.
    extra_hours = np.array([1.2, 2.4, 1.3, 1.3, 0.0, 1.0, 1.8, 0.8, 4.6, 1.4])
    estimate = mean(extra_hours)
    assert estimate.value == pytest.approx(1.58)
    assert (estimate.low, estimate.high) == pytest.approx((0.7001, 2.4599), abs=1e-4)


def test_mean_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(0)
    estimates = [mean(rng.normal(3, 2, 12)) for _ in range(2000)]
    assert np.mean([estimate.low <= 3 <= estimate.high for estimate in estimates]) == pytest.approx(0.95, abs=0.015)


@pytest.mark.parametrize("values", [[4.0], [2.0, 4.0, 6.0]])
def test_few_values_say_nothing_of_their_precision(values):
    estimate = mean(np.array(values))
    assert (estimate.value, estimate.low, estimate.high) == (4, None, None)


def test_mcnemar_is_exact_and_counts_pairs():
    a = np.array([True] * 8 + [False] * 2 + [True] * 5 + [False] * 3)
    b = np.array([False] * 8 + [True] * 2 + [True] * 5 + [False] * 3)
    zeros = np.zeros(18)
    pair = paired_difference("a", "b", (a, b), (zeros + 2, zeros), (zeros + 7, zeros + 4))
    assert (pair.both, pair.only_a, pair.only_b, pair.neither) == (5, 8, 2, 3)
    assert pair.mcnemar_p == pytest.approx(2 * (1 + 10 + 45) / 2**10)
    assert pair.return_difference.value == 2
    assert pair.steps_difference.value == 3


def test_equal_policies_do_not_differ():
    won = np.array([True, False, True])
    pair = paired_difference("a", "b", (won, won), (won * 1.0, won * 1.0), (won * 1.0, won * 1.0))
    assert pair.mcnemar_p == 1
    assert pair.return_difference.value == 0


def test_median_has_the_coverage_it_claims():
    rng = np.random.default_rng(0)
    estimates = [median(rng.exponential(size=60)) for _ in range(400)]
    assert 0.93 <= np.mean([one.low <= np.log(2) <= one.high for one in estimates]) <= 0.99
    assert median(np.empty(0)) is None
    assert median(np.arange(5.0)) == Estimate(2.0, None, None)


def test_mcnemar_against_agresti():
    # Agresti, "Categorical data analysis", section 10.1: approval of the prime minister, 150 and 86 changed their
    # minds, z = -4.17. Exact: the binomial tail, added up here in whole numbers.
    a = np.repeat([True, True, False, False], [794, 150, 86, 570])
    b = np.repeat([True, False, True, False], [794, 150, 86, 570])
    pair = paired_difference("a", "b", (a, b), (a * 1.0, b * 1.0), (a * 1.0, b * 1.0))
    exact = 2 * sum(math.comb(236, k) for k in range(87)) / 2**236
    assert (pair.only_a, pair.only_b) == (150, 86)
    assert pair.mcnemar_p == pytest.approx(exact)
    assert pair.mcnemar_p == pytest.approx(math.erfc(4.17 / math.sqrt(2)), rel=0.25)


def test_interquartile_mean_is_the_mean_of_the_middle_half():
    # rliable: scipy.stats.trim_mean(scores, 0.25) over all runs; of 10, floor(2.5) are cut at either end.
    assert interquartile_mean([np.array([-900.0, 1, 2, 3, 4, 5, 6, 900])]).value == (2 + 3 + 4 + 5) / 4
    assert interquartile_mean([np.arange(5.0), np.arange(5.0) + 5]).value == (2 + 3 + 4 + 5 + 6 + 7) / 6
    assert interquartile_mean([np.arange(4.0)]).low is None
    assert interquartile_mean([np.array([])]) is None


def test_interquartile_mean_is_resampled_within_each_training():
    # Within a stratum all are alike, so that no resampling of episodes moves the mean: nothing is known.
    apart = interquartile_mean([np.zeros(10), np.ones(10)])
    assert (apart.value, apart.low, apart.high) == (0.5, None, None)
    together = interquartile_mean([np.repeat([0.0, 1.0], 10)])
    assert together.low < 0.5 < together.high


def test_interquartile_mean_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(0)
    estimates = [interquartile_mean([rng.normal(3, 2, 40)]) for _ in range(100)]
    assert 0.86 <= np.mean([one.low <= 3 <= one.high for one in estimates]) <= 1


def test_mann_whitney_against_conover():
    # Conover (1999), example 5.1.1: fitness of farm and town boys; ranks of the former add up to 321, p = 0.52.
    farm = np.array([14.8, 7.3, 5.6, 6.3, 9.0, 4.2, 10.6, 12.5, 12.9, 16.1, 11.4, 2.7])
    town = [12.7, 14.2, 12.6, 2.1, 17.7, 11.8, 16.9, 7.9, 16.0, 10.6, 5.6, 5.6, 7.6, 11.3, 8.3, 6.7, 3.6, 1.0]
    town += [2.4, 6.4, 9.1, 6.7, 18.6, 3.2, 6.2, 6.1, 15.3, 10.6, 1.8, 5.9, 9.9, 10.6, 14.8, 5.0, 2.6, 4.0]
    found = superiority(farm, np.array(town))
    assert found.probability.value == 243 / (12 * 36)
    assert found.p == pytest.approx(0.52, abs=0.01)
    assert found.probability.low < 0.5 < found.probability.high


SCORES = st.lists(st.integers(-3, 3), min_size=1, max_size=8)


@settings(deadline=None, max_examples=30)
@given(SCORES, SCORES)
def test_superiority_counts_pairs(a, b):
    a, b = np.array(a, dtype=float), np.array(b, dtype=float)
    wins = (np.sign(a[:, None] - b) + 1) / 2
    assert superiority(a, b).probability.value == pytest.approx(wins.mean())
    assert superiority(b, a).probability.value == pytest.approx(1 - wins.mean())
    assert 0 <= superiority(a, b).p <= 1


def test_pairs_tell_more_than_their_parts():
    hardness = np.linspace(0, 100, 40)
    a, b = hardness + 1.0, hardness.copy()
    b[:4] += 2
    paired = paired_superiority(a, b)
    assert paired.probability.value == 36 / 40
    assert paired.probability.low > 0.75
    assert paired.p == pytest.approx(2 * sum(math.comb(40, k) for k in range(5)) / 2**40)
    assert superiority(a, b).p > 0.5


def test_a_tie_counts_half_and_certainty_has_no_interval():
    found = paired_superiority(np.array([1.0, 2, 3, 4]), np.array([0.0, 2, 4, 4]))
    assert (found.probability.value, found.p) == (0.5, 1)
    always = paired_superiority(np.ones(20), np.zeros(20)).probability
    assert (always.value, always.low, always.high) == (1, None, None)
    assert superiority(np.ones(20), np.ones(20)).p == 1


def test_performance_profile_is_the_share_above():
    profile = performance_profile(np.array([1.0, 2, 2, 5]), np.array([0.0, 2, 4.9, 5]))
    assert [point.value for point in profile] == [1, 0.25, 0.25, 0]
    assert all(point.low <= point.value <= point.high for point in profile)


def test_performance_ratios_of_dolan_and_more():
    ratios = performance_ratios({"a": np.array([1.0, 3.0, np.inf]), "b": np.array([2.0, 2.0, 4.0])})
    assert ratios["a"].tolist() == [1, 1.5, np.inf]
    assert ratios["b"].tolist() == [2, 1, 1]
    solved = performance_profile(-ratios["a"], np.array([-1e9, -1.2]))  # in the end, and at most 1.2 times the best
    assert [point.value for point in solved] == pytest.approx([2 / 3, 1 / 3])
    assert np.isinf(performance_ratios({"a": np.array([np.inf]), "b": np.array([np.inf])})["a"]).all()


LOOMS = [[98, 97, 99, 96], [91, 90, 93, 92], [96, 95, 97, 95], [95, 96, 99, 98]]


def test_trainings_against_montgomery():
    # Montgomery, "Design and analysis of experiments", 8th ed. (2012), example 3.11: strength of fabric by loom;
    # variance components 1.90 and 6.96, 95 % interval of the mean 95.44 +- 4.34.
    found = mean_over_trainings([np.array(loom, dtype=float) for loom in LOOMS])
    assert found.within**2 == pytest.approx(1.90, abs=0.005)
    assert found.between**2 == pytest.approx(6.96, abs=0.005)
    assert (found.mean.value, found.mean.low, found.mean.high) == pytest.approx((95.44, 91.10, 99.78), abs=0.005)
    assert found.trainings == 4


def test_one_training_says_nothing_of_others():
    found = mean_over_trainings([np.arange(1000.0)])
    assert (found.mean.value, found.mean.low, found.mean.high, found.between) == (499.5, None, None, None)
    assert found.within == pytest.approx(np.std(np.arange(1000), ddof=1))


def test_many_episodes_do_not_make_up_for_few_trainings():
    rng = np.random.default_rng(0)
    held, pooled = 0, 0
    for _ in range(300):
        scores = [rng.normal(rng.normal(0, 1), 1, 200) for _ in range(4)]
        two_level, flat = mean_over_trainings(scores).mean, mean(np.concatenate(scores))
        held += two_level.low <= 0 <= two_level.high
        pooled += flat.low <= 0 <= flat.high
    assert held / 300 == pytest.approx(0.95, abs=0.04)
    assert pooled / 300 < 0.3
