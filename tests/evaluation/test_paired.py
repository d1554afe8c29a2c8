import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.evaluation.paired import (
    episodes_to_detect,
    episodes_to_show_equivalence,
    holm,
    mcnemar,
    paired_difference,
    tango,
)


def test_mcnemar_is_exact_and_counts_pairs():
    a = np.array([True] * 8 + [False] * 2 + [True] * 5 + [False] * 3)
    b = np.array([False] * 8 + [True] * 2 + [True] * 5 + [False] * 3)
    zeros = np.zeros(18)
    pair = paired_difference("a", "b", (a, b), (zeros + 2, zeros), (zeros + 7, zeros + 4), (0.0, 2.0), 10)
    assert (pair.both, pair.only_a, pair.only_b, pair.neither) == (5, 8, 2, 3)
    assert pair.mcnemar_p == pytest.approx(2 * (1 + 10 + 45) / 2**10)
    assert pair.return_difference.value == 2
    assert pair.steps_difference.value == 3


def test_equal_policies_do_not_differ():
    won = np.array([True, False, True])
    pair = paired_difference("a", "b", (won, won), (won * 1.0, won * 1.0), None, (0.0, 1.0))
    assert pair.mcnemar_p == 1
    assert pair.return_difference.value == 0


def test_mcnemar_against_agresti():
    # Agresti, "Categorical data analysis", section 10.1: approval of the prime minister, 150 and 86 changed their
    # minds, z = -4.17. Exact: the binomial tail, added up here in whole numbers.
    a = np.repeat([True, True, False, False], [794, 150, 86, 570])
    b = np.repeat([True, False, True, False], [794, 150, 86, 570])
    pair = paired_difference("a", "b", (a, b), (a * 1.0, b * 1.0), None, (0.0, 1.0))
    exact = 2 * sum(math.comb(236, k) for k in range(87)) / 2**236
    assert (pair.only_a, pair.only_b) == (150, 86)
    assert pair.mcnemar_p == pytest.approx(exact)
    assert pair.mcnemar_p == pytest.approx(math.erfc(4.17 / math.sqrt(2)), rel=0.25)


@pytest.mark.parametrize(
    ("only_a", "only_b", "episodes", "confidence", "low", "high"),
    [
        # Fagerland, Lydersen and Laake (2014), "Recommended tests and confidence intervals for paired binomial
        # proportions", Statistics in Medicine 33, table V: airway hyper-responsiveness.
        (1, 7, 21, 0.95, -0.517, -0.026),
        (48, 41, 549, 0.90, -0.0157, 0.0414),  # scoreci.mp of the R package PropCIs, in percent with two decimals
    ],
)
def test_tango_against_others(only_a, only_b, episodes, confidence, low, high):
    found = tango(only_a, only_b, episodes, confidence)
    assert found.value == pytest.approx((only_a - only_b) / episodes)
    assert (found.low, found.high) == pytest.approx((low, high), abs=5e-4)


@given(st.integers(0, 30), st.integers(0, 30), st.integers(1, 1000))
@settings(deadline=None)
def test_tango_holds_the_difference_and_is_the_same_for_either(only_a, only_b, others):
    episodes = only_a + only_b + others
    found, turned = tango(only_a, only_b, episodes), tango(only_b, only_a, episodes)
    assert -1 <= found.low <= found.value <= found.high <= 1
    assert (found.low, found.high) == pytest.approx((-turned.high, -turned.low), abs=1e-6)
    wider = tango(only_a, only_b, episodes, 0.99)
    assert wider.low <= found.low + 1e-9
    assert wider.high >= found.high - 1e-9


def test_without_disagreement_tango_is_wide_as_wilson():
    z = 1.959964
    assert tango(0, 0, 200).high == pytest.approx(z**2 / (200 + z**2), abs=1e-6)
    assert tango(5, 0, 5).high == pytest.approx(1)


def pair_of(only_a, only_b, episodes):
    a = np.arange(episodes) < only_a
    b = np.arange(episodes) >= episodes - only_b
    return paired_difference("a", "b", (a, b), (a * 1.0, b * 1.0), None, (0.0, 1.0))


def test_equivalence_takes_episodes():
    assert not pair_of(0, 0, 100).equivalent(0.02)
    assert pair_of(0, 0, 200).equivalent(0.02)
    assert not pair_of(3, 0, 200).equivalent(0.02)
    assert pair_of(3, 0, 200).equivalent(0.05)


def test_holm_against_holm():
    # Holm (1979): each p-value is multiplied by the number of claims that are left, and is no less than the last one.
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.5, 0.9]) == [1, 1]
    assert holm([]) == []


@pytest.mark.parametrize(("difference", "discordant"), [(0.02, 0.02), (0.02, 0.1), (0.1, 0.3)])
def test_planned_episodes_have_the_power_that_was_asked_for(difference, discordant):
    episodes = episodes_to_detect(difference, discordant)
    rng = np.random.default_rng(0)
    only_a, only_b = (discordant + difference) / 2, (discordant - difference) / 2
    counts = rng.multinomial(episodes, [only_a, only_b, 1 - discordant], size=2000)
    told = np.mean([mcnemar(a, b) < 0.05 for a, b, _ in counts])
    assert told == pytest.approx(0.8, abs=0.05)


@pytest.mark.parametrize("discordant", [0.0, 0.02, 0.1])
def test_planned_episodes_show_equivalence_as_often_as_was_asked_for(discordant):
    episodes = episodes_to_show_equivalence(0.03, discordant)
    counts = np.random.default_rng(0).multinomial(episodes, [discordant / 2, discordant / 2, 1 - discordant], size=500)
    told = np.mean([(found := tango(a, b, episodes, 0.9)).low > -0.03 and found.high < 0.03 for a, b, _ in counts])
    assert told >= 0.75
