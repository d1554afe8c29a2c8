"""What a verdict tells holds though it has chosen among several pairs, and tests several figures of each."""

import dataclasses
import itertools
import re

import numpy as np
import pytest
from scipy import stats

from armctl.agents.costs import TrainingCost
from armctl.stats.correction import holm, holm_adjusted
from armctl.stats.difference import Difference, Scores, Simultaneous, difference_between
from armctl.stats.intervals import Estimate, Superiority
from armctl.stats.paired import mover
from armctl.verdict.pairs import verdict_pairs
from armctl.verdict.summary_tables import difference_table

from .made_up_verdicts import AGENTS, compared, played, said, summary_of, text_of


def test_all_that_a_verdict_may_tell_is_corrected_together():
    wins = {"reach_ik": range(390), "reach_ppo": range(380), "reach_mpc": range(375)}
    pace = {"reach_ik": np.full(400, 20.0), "reach_ppo": np.arange(400) % 40, "reach_mpc": np.arange(400) % 38}
    _, pairs = played(wins, steps=pace)
    tests = [p for pair in pairs for p in (pair.success_p, pair.steps_p, pair.return_p)]
    found = holm_adjusted(pairs)
    assert [p for one in found for p in (one.success, one.steps, one.returns)] == holm(tests)
    assert {one.tests for one in found} == {9}
    with_ik = [pair for pair in pairs if "reach_ik" in (pair.a, pair.b)]
    of_ik = holm_adjusted(pairs, "reach_ik")
    assert [one for one in of_ik if one.tests == 6] == holm_adjusted(with_ik)
    assert [one for one in of_ik if one.tests == 9] == [found[2]]
    assert difference_table(pairs).records[0]["p_corrected"] == found[0].success


@pytest.fixture
def without_plans(monkeypatch):
    """How many more episodes it would take, four fifths of the time of a verdict, is not reckoned."""
    for name in ("episodes_to_detect", "episodes_to_show_equivalence"):
        monkeypatch.setattr(f"armctl.verdict.sentences.{name}", lambda *_, **__: 1_000)


@pytest.mark.slow
@pytest.mark.usefixtures("without_plans")
@pytest.mark.parametrize("policies", [2, 3])
def test_of_equally_good_policies_anything_is_told_in_five_of_a_hundred_verdicts_at_most(policies, sized):
    rng, runs = np.random.default_rng(policies), sized(60, 150)
    names, wrong = ["reach_ik", "reach_ppo", "reach_mpc"][:policies], 0
    for _ in range(runs):
        won = dict(zip(names, rng.random((policies, 60)) < 0.5, strict=True))
        pace = dict(zip(names, 20.0 * rng.integers(1, 4, (policies, 60)), strict=True))
        earned = dict(zip(names, rng.integers(0, 2, (policies, 60)) * 1.0, strict=True))
        text = text_of(*compared(won, pace, earned)).partition("reach_ppo was trained")[0]
        wrong += any(claim in text for claim in (" is better than ", " fewer steps", " earns "))
    assert wrong / runs <= 0.05 + 2 * (0.05 * 0.95 / runs) ** 0.5


@pytest.mark.parametrize("agents", [2, 9])
def test_the_interval_of_the_chosen_pair_holds(agents, sized):
    # With one planner and nine agents, the chosen pair's own 95 % interval holds in 88 % of comparisons.
    rng, runs = np.random.default_rng(0), sized(60, 150)
    more = ("moving_dagger", "reach_cloned_ppo", "reach_robust_ppo", "bridge_ppo")
    names, held = ["reach_ik", *(*AGENTS, *more)[:agents]], 0
    for _ in range(runs):
        won = dict(zip(names, rng.random((1 + agents, 100)) < 0.8, strict=True))
        trained = {name: TrainingCost() if name == "reach_ik" else TrainingCost(1000) for name in names}
        policies = [dataclasses.replace(summary_of(name, of), training=trained[name]) for name, of in won.items()]
        (one,) = verdict_pairs(policies, counted(won), None)
        assert one.num_comparisons == agents
        held += one.success.low <= 0 <= one.success.high
    assert held / runs >= 0.95 - 2 * (0.05 * 0.95 / runs) ** 0.5


def counted(won):
    """Pairs that know only of success."""
    never = Estimate(0.0, None, None)
    return [
        Difference(
            a, b, (len(won[a]), len(won[b])), never, Superiority(never, 1.0), None, Simultaneous(never, never, None),
            success_p=1.0, only_a=int((won[a] & ~won[b]).sum()), only_b=int((won[b] & ~won[a]).sum()),
        )
        for a, b in itertools.combinations(won, 2)
    ]  # fmt: skip


def test_intervals_of_the_sentence_hold_for_all_pairs_at_once():
    rng = np.random.default_rng(0)
    names = ["reach_ik", "reach_mpc", "reach_ppo", "reach_sac"]
    won = dict(zip(names, rng.random((4, 200)) < 0.9, strict=True))
    policies, pairs = compared(won, {name: rng.integers(10, 60, 200) * 1.0 for name in names})
    (one,) = verdict_pairs(policies, pairs, None)
    assert one.num_comparisons == 4  # two classical and two learned ones
    assert abs(one.success.value) == abs(one.difference.success_difference.value)
    counts = (one.difference.only_a, one.difference.only_b, 200)
    assert one.difference.success_among(4) == mover(*counts, 1 - 0.05 / 4)
    assert one.difference.success_difference == mover(*counts)
    spans = (
        (one.difference.simultaneous.steps, one.difference.steps_difference),
        (one.difference.simultaneous.returns, one.difference.return_difference),
    )
    for wide, own in spans:
        assert wide.high - wide.low > 1.2 * (own.high - own.low)
        assert abs(wide.value) == abs(own.value)
    assert verdict_pairs(policies, pairs, "reach_ik")[0].num_comparisons == 3
    renamed = {name.replace("reach_mpc", "mine.py:pd"): of for name, of in won.items()}
    renamed["mine.py:pd"] = np.zeros(200, dtype=bool)
    policies, pairs = compared(renamed)
    assert [found.num_comparisons for found in verdict_pairs(policies, pairs, None)] == [6, 6]  # all: one more is told


def test_the_best_of_each_kind_are_compared_each_with_each():
    wins = {"reach_ik": 300, "reach_mpc": 380, "reach_ppo": 340, "reach_sac": 200, "mixed": 390, "mixed_too": 100}
    policies, pairs = played({name: range(count) for name, count in wins.items()})
    kinds = {"mixed": "hybrid", "mixed_too": "hybrid"}
    policies = [dataclasses.replace(policy, kind=kinds.get(policy.policy)) for policy in policies]
    found = verdict_pairs(policies, pairs, None)[:3]
    assert [(pair.first.policy, pair.second.policy) for pair in found] == [
        ("reach_mpc", "reach_ppo"), ("mixed", "reach_mpc"), ("mixed", "reach_ppo"),
    ]  # fmt: skip
    text = text_of(policies, pairs)
    assert text.startswith("reach_mpc is better than reach_ppo: ")
    assert "mixed is better than reach_ppo: " in text
    assert "Median decision time: reach_mpc 0.25 ms (99th percentile 0.5 ms), reach_ppo" in text
    assert ", mixed 0.25 ms" in text


def test_the_pairs_of_three_kinds_are_corrected_for_all_among_which_they_were_chosen(monkeypatch):
    monkeypatch.setattr("armctl.verdict.pairs.policy_names", lambda: ["reach_ik", "reach_mpc", "reach_ppo", "mixed"])
    policies, pairs = played({"reach_ik": range(300), "reach_mpc": range(280), "reach_ppo": range(250), "mixed": []})
    policies[3] = dataclasses.replace(policies[3], kind="hybrid")
    assert [pair.num_comparisons for pair in verdict_pairs(policies, pairs, None)] == [5, 5, 5]  # 2 + 2 + 1


def test_equivalence_is_for_all_pairs_among_which_the_best_were_chosen():
    alone = {name: range(170) for name in ("reach_ik", "reach_ppo")}
    assert said(alone, 170).startswith("reach_ik and reach_ppo are equivalent in success within 2 points")
    with_another = said({**alone, "reach_bc": range(170)}, 170)
    assert with_another.startswith("Undecided between reach_ik and reach_ppo: success +0.0 points [")


@pytest.mark.slow
@pytest.mark.usefixtures("without_plans")
@pytest.mark.usefixtures("without_plans")
def test_the_best_of_many_is_not_equivalent_for_being_the_best():
    # One planner of 98 %, five agents of 96 %: without correction, 17 % of verdicts claimed equivalence.
    rng = np.random.default_rng(0)
    claimed = 0
    for _ in range(50):
        ease = (rng.normal(size=1000) + rng.normal(size=(6, 1000))) / 2**0.5
        won = ease < stats.norm.ppf([0.98, *[0.96] * 5])[:, None]
        names = ["reach_ik", *AGENTS]
        pairs = [
            difference_between(
                names[i], names[j], Scores((won[i], won[j]), (won[i] * 1.0, won[j] * 1.0), None, (0.0, 1.0))
            )
            for i, j in itertools.combinations(range(6), 2)
        ]
        text = text_of([summary_of(name, of) for name, of in zip(names, won, strict=True)], pairs)
        claimed += "are equivalent in success within 2 points" in text.partition(". ")[0]
    assert claimed <= 5


def test_verdicts_by_return_are_corrected_for_their_number():
    gain = np.where(np.arange(200) < 118, 0.5, -0.5)
    returns = {"a": gain, "b": np.zeros(200), "c": np.zeros(200), "d": np.zeros(200)}
    pairs = [
        difference_between(a, b, Scores(None, (returns[a], returns[b]), None, (-1.0, 1.0)))
        for a, b in itertools.combinations(returns, 2)
    ]
    first = pairs[0]
    assert first.return_p < 0.05 < 6 * first.return_p
    summaries = [
        dataclasses.replace(
            summary_of(name, np.ones(200, dtype=bool)), success=None, episode_return=Estimate(one.mean(), None, None)
        )
        for name, one in returns.items()
    ]
    assert re.match(
        r"a earns 0\.1 \[0\.0, 0\.2\] more return per episode than b, p = 0\.0\d+\.", text_of(summaries[:2], pairs[:1])
    )
    assert text_of(summaries, pairs).startswith("The returns of a and b do not differ significantly.")


GROUPS_TEST = "random weights of trainings and of episodes"
BETTING = "test by betting, which holds at any number of episodes,"


@pytest.mark.parametrize(
    ("names", "any_number", "test"),
    [
        ("a b", False, "McNemar's exact test"),
        ("a b", True, BETTING),
        ("a g[*]", False, GROUPS_TEST),
        ("a b g[*]", False, f"McNemar's exact test, of [*] {GROUPS_TEST},"),
        ("a b g[*]", True, f"{BETTING} of [*] {GROUPS_TEST},"),
    ],
)
def test_captions_name_the_test_of_groups(names, any_number, test):
    _, pairs = played({name: range(30 + i) for i, name in enumerate(names.split())}, episodes=40)
    pairs = [dataclasses.replace(pair, any_number=any_number and "[*]" not in pair.b) for pair in pairs]
    assert f"p: {test} for equal success, after Holm's" in difference_table(pairs).caption
    by_return = difference_table([dataclasses.replace(pair, success_p=None) for pair in pairs]).caption
    assert ("sign test" in by_return, GROUPS_TEST in by_return) == ("b" in names, "g" in names)
