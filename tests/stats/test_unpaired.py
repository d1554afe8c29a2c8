"""Two policies on different episodes."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from armctl.stats import intervals
from armctl.stats.difference import Scores, difference_between
from armctl.stats.intervals import bounded_sum
from armctl.stats.paired import combined
from armctl.stats.trainings import difference_over_trainings, superiority_over_trainings
from armctl.stats.unpaired import newcombe, unconditional, unpaired_power

SIZES = [(10, 10), (20, 20), (10, 60), (40, 25)]
RATES = [0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.999, 1.0]


def outcomes(n, m):
    return itertools.product(range(n + 1), range(m + 1))


def test_the_exact_test_against_the_literature():
    # Mehta and Senchaudhuri, "Conditional versus unconditional exact tests for comparing two binomials" (2003):
    # 7 of 15 vaccinated and 12 of 15 others were infected; Barnard's one-sided p is 0.0341, Fisher's 0.0641.
    assert unconditional(7, 15, 12, 15) == pytest.approx(2 * 0.0341, abs=1e-4)


@pytest.mark.parametrize(("a", "n", "b", "m"), [(7, 15, 12, 15), (20, 20, 14, 20), (48, 50, 41, 50), (3, 12, 9, 12)])
def test_the_exact_test_against_scipy(a, n, b, m):
    table = np.array([[a, b], [n - a, m - b]])
    barnard = 2 * stats.barnard_exact(table, alternative="less" if a < b else "greater").pvalue
    assert unconditional(a, n, b, m) == pytest.approx(barnard, rel=0.1)  # whose order is another one
    assert unconditional(a, n, b, m) < stats.fisher_exact(table).pvalue


@pytest.mark.parametrize(
    ("a", "n", "b", "m", "low", "high"),
    # Newcombe (1998), "Interval estimation for the difference between independent proportions", table II, method 10.
    [
        (56, 70, 48, 80, 0.0524, 0.3339), (9, 10, 3, 10, 0.1705, 0.8090), (6, 7, 2, 7, 0.0582, 0.8062),
        (5, 56, 0, 29, -0.0381, 0.1926), (0, 10, 0, 20, -0.1611, 0.2775), (10, 10, 0, 10, 0.6075, 1.0),
    ],
)  # fmt: skip
def test_limits_are_combined_as_by_newcombe(a, n, b, m, low, high):
    wilson = [stats.binomtest(k, size).proportion_ci(method="wilson") for k, size in ((a, n), (b, m))]
    limits_a, limits_b = ((one.low, one.high) for one in wilson)
    found = combined(a / n, limits_a, b / m, limits_b)
    assert (found.low, found.high) == pytest.approx((low, high), abs=6e-5)
    wider = newcombe(a, n, b, m)
    assert wider.low <= found.low + 1e-9 or wider.low == 0
    assert wider.high >= found.high - 1e-9


@pytest.mark.one_case
@pytest.mark.parametrize(("n", "m"), SIZES)
def test_errors_are_as_rare_as_they_are_said_to_be(n, m):
    """All outcomes, at all rates: neither test nor interval errs in more than 2.5 % of cases on one side, or hardly."""
    pairs = list(outcomes(n, m))
    p = np.array([unconditional(a, n, b, m) for a, b in pairs])
    intervals = np.array([newcombe(a, n, b, m).bounds for a, b in pairs])
    lead = np.array([a / n - b / m for a, b in pairs])
    wins = np.array(pairs)
    for a, b in itertools.product(RATES, RATES):
        probability = stats.binom.pmf(wins[:, 0], n, a) * stats.binom.pmf(wins[:, 1], m, b)
        if a <= b:
            assert probability @ ((p < 0.05) & (lead > 0)) <= 0.025
        if a >= b:
            assert probability @ ((p < 0.05) & (lead < 0)) <= 0.025
        missed = [intervals[:, 0] > a - b + 1e-12, intervals[:, 1] < a - b - 1e-12]
        assert max(probability @ side for side in missed) < 0.031
        assert probability @ (missed[0] | missed[1]) <= 0.05
    assert ((p < 0.05) == ((intervals[:, 0] >= 0) | (intervals[:, 1] <= 0))).all()
    assert (np.sign(lead) == np.sign(intervals.sum(axis=1)))[p < 0.05].all()


COUNTS = st.tuples(st.integers(1, 300), st.floats(0, 1)).map(lambda drawn: (round(drawn[0] * drawn[1]), drawn[0]))


@settings(max_examples=60, deadline=None)
@given(COUNTS, COUNTS)
def test_sides_and_wins_may_be_exchanged(one, other):
    p, interval = unconditional(*one, *other), newcombe(*one, *other)
    lost = [(n - k, n) for k, n in (one, other)]
    assert p == pytest.approx(unconditional(*other, *one)) == pytest.approx(unconditional(*lost[0], *lost[1]), rel=1e-6)
    assert 0 < p <= 1
    mirrored = -newcombe(*other, *one)
    assert (interval.low, interval.high) == pytest.approx((mirrored.low, mirrored.high))
    assert -1 <= interval.low <= interval.value <= interval.high <= 1
    assert unconditional(*one, *one) == 1
    assert unconditional(one[0] * 3, one[1] * 3, *one) == 1  # the same rate, from more episodes


@pytest.mark.parametrize(
    ("wins", "p"),
    [((0, 1, 1, 1), 0.5), ((0, 1, 0, 1), 1), ((0, 500, 500, 500), 1e-9), ((1, 1, 999, 1000), 1), ((0, 7, 0, 90), 1)],
)
def test_hardly_any_episodes_and_no_wins_at_all(wins, p):
    assert unconditional(*wins) == pytest.approx(p, abs=1e-8)
    low, high = newcombe(*wins).bounds
    assert -1 <= low <= wins[0] / wins[1] - wins[2] / wins[3] <= high <= 1


@pytest.mark.parametrize(("better", "worse", "n", "level"), [(0.95, 0.6, 20, 0.05), (1.0, 0.8, 30, 0.05 / 3)])
def test_the_power_is_that_of_the_test(better, worse, n, level):
    shown = [(a, b) for a, b in outcomes(n, n) if a > b and unconditional(a, n, b, n) < level]
    expected = sum(stats.binom.pmf(a, n, better) * stats.binom.pmf(b, n, worse) for a, b in shown)
    assert unpaired_power(better, worse, n, level) == pytest.approx(expected)


@pytest.mark.parametrize("rate", [0.5, 0.8, 0.95, 0.99])
def test_errors_of_a_thousand_episodes_are_close_to_five_percent(rate):
    assert 0.046 < 2 * unpaired_power(rate, rate, 1000, 0.05) <= 0.05


BOUNDS = (-100.0, 99.0)


def bimodal(rng, n, failures):
    return np.where(rng.random(n) < failures, -100.0, rng.normal(88, 1, n))


@pytest.fixture
def fewer_draws(monkeypatch):
    """Random weights are drawn less often, which makes single intervals less exact, and not their coverage."""
    monkeypatch.setattr(intervals, "DRAWS", 500)


@pytest.mark.parametrize(("n", "m", "failures"), [(50, 50, 0.01), (20, 60, 0.02), (100, 40, 0.005)])
def test_means_of_bimodal_returns_hold_where_welch_does_not(fewer_draws, n, m, failures):
    rng, runs, truth = np.random.default_rng(0), 100, -failures * 188
    held, welch_held = 0.0, 0.0
    for _ in range(runs):
        a, b = bimodal(rng, n, failures), bimodal(rng, m, 0.0)
        low, high = bounded_sum([a, b], [1, -1], BOUNDS).estimate.bounds
        welch = stats.ttest_ind(a, b, equal_var=False).confidence_interval()
        held += float(low <= truth <= high)
        welch_held += float(welch.low <= truth <= welch.high)
    assert held >= 0.93 * runs
    assert welch_held < 0.75 * runs


def test_superiority_holds_with_unequal_variances(fewer_draws):
    rng, runs, level = np.random.default_rng(1), 150, 0.05
    errors, of_mann_whitney = 0, 0
    for _ in range(runs):
        a, b = rng.normal(0, 8, 20), rng.normal(0, 1, 100)
        errors += superiority_over_trainings(a[None], b[None], paired=False)[0].p < level
        of_mann_whitney += int(stats.mannwhitneyu(a, b).pvalue < level)
    assert errors / runs < 0.09 < of_mann_whitney / runs


def test_superiority_against_conover():
    # Conover (1999), example 5.1.1: fitness of farm and town boys; ranks of the former add up to 321, p = 0.52.
    farm = np.array([14.8, 7.3, 5.6, 6.3, 9.0, 4.2, 10.6, 12.5, 12.9, 16.1, 11.4, 2.7])
    town = [12.7, 14.2, 12.6, 2.1, 17.7, 11.8, 16.9, 7.9, 16.0, 10.6, 5.6, 5.6, 7.6, 11.3, 8.3, 6.7, 3.6, 1.0]
    town += [2.4, 6.4, 9.1, 6.7, 18.6, 3.2, 6.2, 6.1, 15.3, 10.6, 1.8, 5.9, 9.9, 10.6, 14.8, 5.0, 2.6, 4.0]
    found, _ = superiority_over_trainings(farm[None], np.array(town)[None], paired=False)
    assert found.probability.value == pytest.approx(243 / (12 * 36))
    assert found.p > 0.52  # one more value at the bound makes it cautious
    assert found.probability.low < 0.5 < found.probability.high


SCORES = st.lists(st.sampled_from([-np.inf, -3.0, 0.0, 1.0, 2.0]), min_size=1, max_size=8).map(np.array)


@settings(max_examples=30, deadline=None)
@given(SCORES, SCORES)
def test_superiority_counts_all_pairs(a, b):
    wins = (np.greater.outer(a, b) * 2.0 + np.equal.outer(a, b)) / 2
    found, wide = superiority_over_trainings(a[None], b[None], 0.99, paired=False)
    assert found.probability.value == wide.value == pytest.approx(wins.mean())
    assert wide.low <= found.probability.low <= wins.mean() <= found.probability.high <= wide.high
    assert superiority_over_trainings(a[None], a[None], paired=False)[0].p == 1


def difference_of(a, b, returns=None, steps=None, num_comparisons=1):
    returns = returns or tuple(np.asarray(won, dtype=float) for won in (a, b))
    scores = Scores((a, b), returns, steps, (0.0, 1.0), 100)
    return difference_between("a", "b", scores, num_comparisons, paired=False)


def test_a_difference_without_pairs_has_wins_of_each_and_nothing_of_pairs():
    a, b = np.arange(40) < 36, np.arange(25) < 10
    found = difference_of(a, b, steps=(np.where(a, 10.0, 100.0), np.where(b, 20.0, 100.0)), num_comparisons=3)
    assert (found.paired, found.sample_sizes, found.wins, found.episodes) == (False, (40, 25), (36, 10), 25)
    assert (found.both_won, found.only_a, found.only_b, found.neither) == (0, 0, 0, 0)
    assert found.success_p == unconditional(36, 40, 10, 25) < 0.001
    assert found.success_difference == newcombe(36, 40, 10, 25)
    assert found.success_among(3) == newcombe(36, 40, 10, 25, 1 - 0.05 / 3)
    assert found.return_difference.value == pytest.approx(0.5)
    assert found.return_p < 0.01 > found.steps_p
    assert found.steps_difference.value < 0
    assert found.simultaneous.returns.low < found.return_difference.low
    back = found.reversed()
    assert (back.a, back.wins, back.sample_sizes) == ("b", (10, 36), (25, 40))
    assert back.success_difference == newcombe(10, 25, 36, 40)
    assert back.reversed() == found


def test_equal_samples_do_not_differ():
    won = np.arange(60) < 55
    found = difference_of(won, won)
    assert (found.success_p, found.return_p, found.superiority.p) == (1, 1, 1)
    assert found.return_difference.value == 0
    assert not found.equivalent(0.02)
    assert difference_of(np.arange(900) < 898, np.arange(800) < 799).equivalent(0.02)


def test_unknown_bounds_and_a_single_episode_conclude_nothing_of_means():
    scores = (np.array([3.0]), np.array([1.0, 2.0]))
    found = difference_between("a", "b", Scores(None, scores), paired=False)
    assert (found.success_p, found.success_difference, found.return_p, found.steps_difference) == (None,) * 4
    assert found.return_difference.bounds == pytest.approx((np.nan, np.nan), nan_ok=True)
    assert found.superiority.p > 0.05
    crashed = difference_between("a", "b", Scores(None, (np.array([-np.inf, 1.0]), np.ones(3))), paired=False)
    assert np.isnan(crashed.return_difference.value)
    assert crashed.superiority.probability.value == 0.25


def test_groups_of_trainings_on_different_episodes():
    rng = np.random.default_rng(0)
    group, single = (rng.random((8, 60)) < 0.9).astype(float), (rng.random(90) < 0.2).astype(float)
    found = difference_between("g[*]", "b", Scores((group, single), (group, single), None, (0.0, 1.0)), paired=False)
    assert found.crossed is not None
    assert found.success_p == found.crossed.p < 0.05
    assert found.sample_sizes == (60, 90)
    assert found.wins == (round(group.mean() * 60), single.sum())
    assert found.success_difference.value == pytest.approx(group.mean() - single.mean())
    low, high = found.crossed.if_normal.bounds
    assert found.success_difference.low < low < found.success_difference.value < high
    cautious = difference_over_trainings(group[:3], group[:3], (0.0, 1.0), paired=False)
    assert cautious.p == 1
    assert cautious.estimate.high > 0.5


@pytest.mark.parametrize("share", [0.05, 0.5])
def test_without_pairs_a_test_of_hardness_finds_less(share):
    """Where both meet the same hard episodes, pairs tell more: what is lost when an environment ignores its seed."""
    rng = np.random.default_rng(0)
    hard = rng.random(300) < share
    won = (~hard).astype(float), (~hard & (rng.random(300) < 0.96)).astype(float)
    pair, apart = (difference_between("a", "b", Scores(won, won), paired=paired) for paired in (True, False))
    assert pair.success_difference.value == pytest.approx(apart.success_difference.value)
    assert pair.success_p < apart.success_p
