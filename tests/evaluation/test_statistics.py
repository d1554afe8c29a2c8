import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armctl.evaluation.statistics import Estimate, mean, median, paired_difference, success_rate


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
