import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from armctl.episodes.table import EpisodeTable
from armctl.stats.correction import holm
from armctl.stats.difference import Scores, difference_between
from armctl.stats.intervals import bounded_difference
from armctl.stats.paired import mover
from armctl.stats.power import episodes_to_show_equivalence
from armctl.stats.trainings import difference_over_trainings
from armctl.verdict.scores import Limits, pairs_of, scores_of

from ..made_up_episodes import played


def test_mcnemar_is_exact_and_counts_pairs():
    a = np.array([True] * 8 + [False] * 2 + [True] * 5 + [False] * 3)
    b = np.array([False] * 8 + [True] * 2 + [True] * 5 + [False] * 3)
    zeros = np.zeros(18)
    pair = difference_between("a", "b", Scores((a, b), (zeros + 2, zeros), (zeros + 7, zeros + 4), (0.0, 2.0), 10))
    assert (pair.both_won, pair.only_a, pair.only_b, pair.neither) == (5, 8, 2, 3)
    assert pair.success_p == pytest.approx(2 * (1 + 10 + 45) / 2**10)
    assert pair.return_difference.value == 2
    assert pair.steps_difference.value == 3


def test_equal_policies_do_not_differ():
    won = np.array([True, False, True])
    pair = difference_between("a", "b", Scores((won, won), (won * 1.0, won * 1.0), None, (0.0, 1.0)))
    assert pair.success_p == 1
    assert pair.return_difference.value == 0


def test_mcnemar_against_agresti():
    # Agresti, "Categorical data analysis", section 10.1: approval of the prime minister, 150 and 86 changed their
    # minds, z = -4.17. Exact: the binomial tail, added up here in whole numbers.
    a = np.repeat([True, True, False, False], [794, 150, 86, 570])
    b = np.repeat([True, False, True, False], [794, 150, 86, 570])
    pair = difference_between("a", "b", Scores((a, b), (a * 1.0, b * 1.0), None, (0.0, 1.0)))
    exact = 2 * sum(math.comb(236, k) for k in range(87)) / 2**236
    assert (pair.only_a, pair.only_b) == (150, 86)
    assert pair.success_p == pytest.approx(exact)
    assert pair.success_p == pytest.approx(math.erfc(4.17 / math.sqrt(2)), rel=0.25)


@pytest.mark.parametrize(
    ("only_a", "only_b", "episodes", "confidence", "low", "high"),
    [
        # R, binom.test: 1 of 21, 0.0012 to 0.2382; 7 of 21, 0.1459 to 0.5697; correlation -sqrt(1 * 7 / (20 * 14)).
        (1, 7, 21, 0.95, -0.5337, 0.0019),
        (0, 0, 200, 0.95, -0.018275, 0.018275),  # 0 of 200: 1 - 0.025 ** (1 / 200)
        (5, 0, 5, 0.95, 0.2620, 1.0),  # 1 - sqrt((1 - 0.4782)^2 + 0.5218^2) and 5 of 5: 0.025 ** (1 / 5) = 0.4782
    ],
)
def test_limits_of_a_difference_from_those_of_both_shares(only_a, only_b, episodes, confidence, low, high):
    found = mover(only_a, only_b, episodes, confidence)
    assert found.value == pytest.approx((only_a - only_b) / episodes)
    assert (found.low, found.high) == pytest.approx((low, high), abs=5e-4)


@given(st.integers(0, 30), st.integers(0, 30), st.integers(1, 1000))
def test_limits_hold_the_difference_and_are_the_same_for_either(only_a, only_b, others):
    episodes = only_a + only_b + others
    found, turned = mover(only_a, only_b, episodes), mover(only_b, only_a, episodes)
    assert -1 <= found.low <= found.value <= found.high <= 1
    assert (found.low, found.high) == pytest.approx((-turned.high, -turned.low), abs=1e-9)
    wider = mover(only_a, only_b, episodes, 0.99)
    assert wider.low <= found.low + 1e-9
    assert wider.high >= found.high - 1e-9


@pytest.mark.parametrize(
    ("n", "shares"), [(20, (0.3, 0.1)), (50, (0.2, 0.01)), (100, (0.05, 0.01)), (200, (0.02, 0.0))]
)
def test_exact_coverage_where_tangos_interval_missed_on_one_side(n, shares):
    # Tango's: 94.7, 93.7, 93.3 and 93.3 %, and up to 5.0 % on one side. Added up over all outcomes.
    truth, too_high, too_low = shares[0] - shares[1], 0.0, 0.0
    chances = stats.binom.pmf(np.arange(n + 1), n, shares[0])
    for only_a in np.flatnonzero(chances > 1e-7):
        given_a = stats.binom.pmf(np.arange(n + 1), n - only_a, shares[1] / (1 - shares[0]))
        for only_b in np.flatnonzero(given_a > 1e-7):
            found = mover(int(only_a), int(only_b), n)
            too_high += chances[only_a] * given_a[only_b] * (found.low > truth + 1e-12)
            too_low += chances[only_a] * given_a[only_b] * (found.high < truth - 1e-12)
    assert too_high <= 0.025
    assert too_low <= 0.025


def pair_of(only_a, only_b, episodes):
    a = np.arange(episodes) < only_a
    b = np.arange(episodes) >= episodes - only_b
    return difference_between("a", "b", Scores((a, b), (a * 1.0, b * 1.0), None, (0.0, 1.0)))


def test_equivalence_takes_episodes():
    assert not pair_of(0, 0, 100).equivalent(0.02)
    assert pair_of(0, 0, 200).equivalent(0.02)
    assert not pair_of(3, 0, 200).equivalent(0.02)
    assert pair_of(3, 0, 200).equivalent(0.05)


def test_holm_against_holm():
    # Holm (1979): each p-value is multiplied by the number of claims that are left, and is no less than the last one.
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, 0.9]) == holm([0.8, 0.9]) == [1, 1]
    assert holm([]) == []


def test_more_claims_take_more_episodes():
    assert pair_of(0, 0, 200).equivalent(0.02, num_comparisons=2)
    assert not pair_of(0, 0, 200).equivalent(0.02, num_comparisons=6)
    needed = episodes_to_show_equivalence(0.02, 0.0, num_comparisons=6)
    assert pair_of(0, 0, needed).equivalent(0.02, num_comparisons=6)
    assert not pair_of(0, 0, needed - 1).equivalent(0.02, num_comparisons=6)


@pytest.mark.parametrize("trainings", [1, 2])
def test_intervals_and_equivalence_are_for_all_pairs_of_a_comparison(trainings):
    played_by = EpisodeTable(played(40, ("x", "y", "b", "c"))).by_policy()
    trained = {"x[*]": [played_by["x"], played_by["y"]][:trainings], "b": [played_by["b"]], "c": [played_by["c"]]}
    limits = Limits((-30.0, 1.0), 30)
    pairs, narrow, wide = pairs_of(trained, True, limits), 1 - 0.1 / 3, 1 - 0.05 / 3
    assert [pair.crossed is not None for pair in pairs] == [trainings > 1, trainings > 1, False]
    for pair in pairs:

        def values(score, pair=pair):
            return [scores_of(score, trained[name], limits) for name in (pair.a, pair.b)]

        for name, score, bounds in (
            ("steps", "restricted_steps", (1.0, 30.0)),
            ("returns", "episode_return", (-30.0, 1.0)),
        ):
            a, b = values(score)
            most = bounds[1] - bounds[0]
            found = (
                difference_over_trainings(a, b, bounds, simultaneous=wide)
                if pair.crossed
                else bounded_difference(a[0] - b[0], (-most, most), wide)
            )
            assert getattr(pair.simultaneous, name) == found.simultaneous
            assert (pair.steps_p if name == "steps" else pair.return_p) == found.p
        if pair.crossed:
            a, b = values("success")
            assert pair.crossed == difference_over_trainings(a, b, (0.0, 1.0), narrow, wide)
            assert (
                pair.success_among(3) == pair.crossed.simultaneous != pair.success_difference == pair.crossed.estimate
            )


def test_groups_are_compared_in_success_return_and_steps_over_their_trainings():
    rng = np.random.default_rng(0)
    won = (rng.random((3, 40)) < 0.9).astype(float), np.ones((1, 40))
    steps = np.where(won[0] == 1, 20.0, 100.0), np.full((1, 40), 15.0)
    pair = difference_between("g[*]", "b", Scores(won, won, steps, (0.0, 1.0), 100))
    expected = difference_over_trainings(*steps, (1.0, 100.0))
    assert (pair.steps_difference, pair.steps_p) == (expected.estimate, expected.p)
    assert (pair.return_difference, pair.return_p) == (pair.crossed.estimate, pair.crossed.p)
    for unknown in ((None, 100), (steps, None)):
        other = difference_between("g[*]", "b", Scores(won, won, unknown[0], (0.0, 1.0), unknown[1]))
        assert (other.steps_difference, other.steps_p, other.simultaneous.steps) == (None, None, None)
    failed = np.where(np.arange(40) == 7, -np.inf, won[0]), won[1]
    lost = difference_between("g[*]", "b", Scores(won, failed, steps, (0.0, 1.0), 100))
    assert np.isnan(lost.return_difference.value)
    assert lost.superiority.probability.value < 0.5


@pytest.mark.parametrize("trainings", [1, 3])
def test_a_reversed_pair_is_that_of_the_second_against_the_first(trainings):
    rng = np.random.default_rng(0)
    won = (rng.random((trainings, 60)) < 0.9).astype(float), (rng.random((1, 60)) < 0.6).astype(float)
    steps = np.where(won[0] == 1, 20.0, 100.0), np.where(won[1] == 1, 20.0, 100.0)
    pair = difference_between("a", "b", Scores(won, won, steps, (0.0, 1.0), 100), 3)
    swapped = won[1], won[0]
    other = difference_between("b", "a", Scores(swapped, swapped, (steps[1], steps[0]), (0.0, 1.0), 100), 3)
    found = pair.reversed()
    back = found.reversed()
    assert (back.a, back.crossed, back.return_difference) == (pair.a, pair.crossed, pair.return_difference)
    for name in ("a", "b", "episodes", "both_won", "only_a", "only_b", "neither"):
        assert getattr(found, name) == getattr(other, name)
    for name in ("success_difference", "return_difference", "steps_difference"):
        assert interval(getattr(found, name)) == pytest.approx(interval(getattr(other, name)), rel=0.05, abs=0.05)
    for name in ("returns", "superiority", "steps"):
        expected = interval(getattr(other.simultaneous, name))
        assert interval(getattr(found.simultaneous, name)) == pytest.approx(expected, rel=0.05, abs=0.05)
    assert interval(found.superiority.probability) == pytest.approx(interval(other.superiority.probability), abs=0.05)
    assert found.equivalent(0.5) == other.equivalent(0.5) == pair.equivalent(0.5)


def interval(estimate):
    return estimate.value, estimate.low, estimate.high


def test_where_success_is_unknown_nothing_is_known_of_it():
    scores = np.arange(20.0)
    pair = difference_between("a", "b", Scores(None, (scores, scores[::-1])))
    assert (pair.success_difference, pair.steps_difference, pair.reversed().steps_difference) == (None, None, None)
    assert (pair.success_p, pair.return_p, pair.return_difference.low) == (None, None, None)
    assert not pair.equivalent(0.9)
