import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from armctl.stats.intervals import (
    GROUPS,
    Estimate,
    bounded_mean,
    grouped,
    mean_of_means,
    median,
    paired_superiority,
    performance_profile,
    performance_ratios,
    success_rate,
    worst_decile,
)
from armctl.stats.trainings import superiority_over_trainings


@pytest.mark.parametrize(
    ("wins", "episodes", "low", "high"),
    # Newcombe (1998), "Two-sided confidence intervals for the single proportion", table I, method 5.
    [(81, 263, 0.2527, 0.3676), (15, 148, 0.0578, 0.1617), (0, 20, 0.0, 0.1684), (1, 29, 0.0009, 0.1776)],
)
def test_exact_interval_against_newcombe(wins, episodes, low, high):
    estimate = success_rate(np.arange(episodes) < wins)
    assert estimate.value == pytest.approx(wins / episodes)
    assert (estimate.low, estimate.high) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize(("wins", "episodes"), [(0, 20), (1, 29), (199, 200), (50, 100), (1000, 1000)])
def test_bounded_mean_of_wins_and_losses_is_the_exact_interval(wins, episodes):
    won = np.arange(episodes) < wins
    found, exact = bounded_mean(won * 1.0, (0.0, 1.0)), success_rate(won)
    assert (found.value, found.low, found.high) == pytest.approx((exact.value, exact.low, exact.high), abs=0.006)


def students(values):
    """Student's interval of a mean, which is far too narrow where disasters are rare."""
    half = stats.sem(values) * stats.t.ppf(0.975, len(values) - 1)
    return Estimate(values.mean(), values.mean() - half, values.mean() + half)


def test_bounded_mean_of_many_values_is_students():
    values = np.random.default_rng(0).normal(3, 2, 2000)
    found, expected = bounded_mean(values, (-8.0, 14.0)), students(values)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=0.02)


def test_bounded_mean_knows_of_disasters_that_were_not_seen():
    returns = np.full(200, 88.0)
    found = bounded_mean(returns, (-100.0, 99.0))
    assert found.value == 88
    assert found.low == pytest.approx(88 - 188 * (1 - 0.025 ** (1 / 200)), abs=0.3)  # of 3.7 in 200
    assert students(returns).low == 88  # Student's does not


@given(
    st.lists(st.floats(-100, 100), min_size=1, max_size=50),
    st.floats(-1000, -100),
    st.floats(100, 1000),
)
@settings(max_examples=50)
def test_bounded_mean_lies_within_its_bounds(values, lowest, highest):
    values = np.array(values)
    found = bounded_mean(values, (lowest, highest))
    assert found.value == pytest.approx(values.mean(), abs=1e-9)
    assert lowest <= found.low <= found.value <= found.high <= highest
    worst = worst_decile(values, (lowest, highest))
    assert lowest - 1e-9 <= worst.low <= worst.value <= worst.high <= highest + 1e-9
    assert worst.value <= found.value + 1e-9
    assert bounded_mean(np.flip(values), (lowest, highest)) == found


def test_worst_decile_is_the_conditional_value_at_risk():
    values = np.array([-100.0, -50.0, *[88.0] * 18])
    assert worst_decile(values, (-100.0, 100.0)).value == pytest.approx(-75)
    assert worst_decile(np.array([-100.0, *[88.0] * 19]), (-100.0, 100.0)).value == pytest.approx(-6)
    assert worst_decile(np.array([]), (-100.0, 100.0)) is None


@given(st.lists(st.booleans(), min_size=1, max_size=200))
def test_limits_of_a_rate_are_where_what_was_seen_has_a_probability_of_a_fortieth(successes):
    estimate, wins, n = success_rate(np.array(successes)), sum(successes), len(successes)
    assert estimate.value == wins / n
    at_low = stats.binom.sf(wins - 1, n, estimate.low) if wins else 0.025 + estimate.low
    at_high = stats.binom.cdf(wins, n, estimate.high) if wins < n else 0.025 + 1 - estimate.high
    assert (at_low, at_high) == pytest.approx((0.025, 0.025), abs=1e-6)


def test_nothing_can_be_said_of_nothing():
    assert success_rate(np.array([], dtype=bool)) is None
    assert mean_of_means([np.array([])], (0.0, 1.0)) is None
    assert worst_decile(np.array([]), None) is None
    assert bounded_mean(np.array([]), (0.0, 1.0)) is None


def test_median_has_the_coverage_it_claims():
    rng = np.random.default_rng(0)
    estimates = [median(rng.exponential(size=60)) for _ in range(400)]
    holds = np.mean([one.low <= np.log(2) <= one.high for one in estimates])
    assert holds == pytest.approx(0.973, abs=0.02)  # 1 - 2 P(B < 22) of 60 fair coins, and two standard errors


@pytest.mark.parametrize("n", [10, 11, 60, 201])
def test_limits_of_a_median_are_the_innermost_order_statistics_that_hold(n):
    """That the k-th smallest of n values lies above the median is as likely as fewer than k heads of n fair coins."""
    found, heads = median(np.arange(1.0, n + 1)), stats.binom(n, 0.5)
    assert heads.cdf(found.low - 1) <= 0.025 < heads.cdf(found.low)
    assert found.low + found.high == n + 1
    assert median(np.empty(0)) is None
    assert median(np.arange(5.0)) == Estimate(2.0, None, None)


def test_pairs_tell_more_than_their_parts():
    hardness = np.linspace(0, 100, 40)
    a, b = hardness + 1.0, hardness.copy()
    b[:4] += 2
    paired = paired_superiority(a, b)
    assert paired.probability.value == 36 / 40
    assert paired.probability.low > 0.75
    assert paired.p == pytest.approx(2 * sum(math.comb(40, k) for k in range(5)) / 2**40)
    assert superiority_over_trainings(a[None], b[None], paired=False)[0].p > 0.5


def test_a_tie_counts_half_and_certainty_has_an_interval():
    found = paired_superiority(np.array([1.0, 2, 3, 4]), np.array([0.0, 2, 4, 4]))
    assert (found.probability.value, found.p) == (0.5, 1)
    always = paired_superiority(np.ones(20), np.zeros(20)).probability
    assert (always.value, always.high) == (1, 1)
    assert always.low == pytest.approx(success_rate(np.ones(20, dtype=bool)).low, abs=0.01)


def test_performance_profile_is_the_share_above():
    profile = performance_profile(np.array([1.0, 2, 2, 5]), np.array([0.0, 2, 4.9, 5]))
    assert profile == [success_rate(np.arange(4) < above) for above in (4, 1, 1, 0)]


def test_performance_ratios_of_dolan_and_more():
    ratios = performance_ratios({"a": np.array([1.0, 3.0, np.inf]), "b": np.array([2.0, 2.0, 4.0])})
    assert ratios["a"].tolist() == [1, 1.5, np.inf]
    assert ratios["b"].tolist() == [2, 1, 1]
    solved = performance_profile(-ratios["a"], np.array([-1e9, -1.2]))  # in the end, and at most 1.2 times the best
    assert [point.value for point in solved] == pytest.approx([2 / 3, 1 / 3])
    assert np.isinf(performance_ratios({"a": np.array([np.inf]), "b": np.array([np.inf])})["a"]).all()


@pytest.mark.parametrize(
    ("draw", "loss"), [("standard_exponential", 1e-5), ("standard_normal", 1e-5), ("standard_cauchy", 5e-4)]
)
def test_groups_of_many_values_make_an_interval_hardly_narrower(draw, loss):
    values = np.sort(getattr(np.random.default_rng(0), draw)(100_000))
    means, sizes = grouped(values, np.ones(len(values), int))
    deviation = np.sqrt(sizes @ (means - values.mean()) ** 2 / len(values))
    assert 1 - loss < deviation / values.std() <= 1 + 1e-12


def test_groups_of_many_values_keep_mean_and_counts_and_span_little_of_the_range():
    rng = np.random.default_rng(0)
    values, counts = np.sort(rng.exponential(size=30_000)), rng.integers(1, 4, 30_000)
    means, sizes = grouped(values, counts)
    assert len(means) <= GROUPS + 1
    assert sizes.sum() == counts.sum()
    assert sizes @ means == pytest.approx(counts @ values)
    last = np.searchsorted(np.cumsum(counts), np.cumsum(sizes))
    first = np.append(0, last[:-1] + 1)
    assert (values[last] - values[first]).max() <= 2 / GROUPS * (values[-1] - values[0])
    for few, whole in zip(grouped(values[:9_000], counts[:9_000]), (values, counts), strict=True):
        np.testing.assert_array_equal(few, whole[:9_000])
