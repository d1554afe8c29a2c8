import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armctl.evaluation.statistics import mean, paired_difference, success_rate


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


def test_bootstrap_interval_is_that_of_the_normal_for_many_values():
    values = np.random.default_rng(0).normal(3, 2, 1000)
    estimate = mean(values)
    half = 1.96 * values.std() / np.sqrt(1000)
    assert estimate.value == values.mean()
    assert (estimate.low, estimate.high) == pytest.approx((values.mean() - half, values.mean() + half), abs=0.02)
    assert estimate == mean(values)


def test_single_and_equal_values_have_no_width():
    for values in (np.array([4.0]), np.full(10, 4.0)):
        estimate = mean(values)
        assert (estimate.value, estimate.low, estimate.high) == (4, 4, 4)


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
