"""What the verdict says, and of whom."""

import dataclasses
import re

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.stats.difference import Scores, difference_between
from armctl.stats.intervals import Estimate
from armctl.stats.power import episodes_to_detect, episodes_to_show_equivalence
from armctl.verdict.sentences import verdict

from ..holding_still import HoldsStill
from .made_up_verdicts import compared, played, said, summary_of, text_of


def test_it_is_about_the_best_planner_and_the_best_agent():
    text = said({"random": [], "reach_ppo": range(300), "reach_ik": range(380), "reach_mpc": range(400)})
    assert text.startswith("reach_mpc is better than reach_ppo: success +25.0 points [")
    assert "(Holm, 12 tests)" in text  # six pairs, success and return: without steps
    assert "reach_ppo was trained for 1.5 million decisions and 940,000 gradient steps (12.0 minutes)" in text
    assert "Their privileges differ: reach_mpc (observation + robot model), reach_ppo (observation)." in text


@pytest.mark.parametrize(
    ("ppo", "says"),
    [
        (
            300,
            r"reach_ik is better than reach_ppo: success \+25\.0 points \[20\.7, 29\.5\], p = \S+ \(Holm, 2 tests\)\.",
        ),
        (400, r"reach_ik and reach_ppo are equivalent in success within 2 points: \+0\.0 points \[-0\.9, 0\.9\]\."),
        (396, r"Undecided between reach_ik and reach_ppo: success \+1\.0 points \[-0\.\d, 2\.\d\], p = 0\.25 .*\."),
    ],
)
def test_it_begins_with_winner_difference_and_cost(ppo, says):
    told = verdict(*played({"reach_ik": range(400), "reach_ppo": range(ppo)}))
    assert re.fullmatch(says, told.result), told.result
    time = "0.25 ms (99th percentile 0.5 ms)"
    took = f"reach_ppo {time} after 1.5 million decisions of training"
    assert told.cost == f"Median decision time: reach_ik {time}, {took}."
    assert len(f"{told.result} {told.cost}".split()) <= 42  # read in ten seconds
    assert str(told) == f"{told.result} {told.cost} {told.context}"


def test_planning_stands_beside_a_short_decision():
    policies, pairs = played({"reach_ik": range(400), "reach_ppo": range(400)})
    policies = [
        dataclasses.replace(one, first_decision_ms=first) for one, first in zip(policies, (310.0, 0.3), strict=True)
    ]
    cost = verdict(policies, pairs).cost
    assert "reach_ik 0.25 ms (99th percentile 0.5 ms, reset and first decision 310 ms), reach_ppo 0.25" in cost
    assert cost.count("first decision") == 1


def test_too_few_episodes_have_no_headline_but_that():
    wins = {"reach_ik": range(5), "reach_ppo": range(4)}
    few = "No verdict from 5 episodes: at least 10 are needed."
    for more in ({}, {"mine.json": range(5)}):
        assert text_of(*played(wins | more, episodes=5)) == few


def test_without_a_learned_policy_it_is_about_the_two_best():
    text = said({"random": range(10), "reach_ik": range(300), "reach_mpc": range(400)})
    assert text.startswith("reach_mpc is better than reach_ik")
    assert "trained" not in text


@pytest.mark.parametrize("order", [["reach_ik", "reach_ppo"], ["reach_ppo", "reach_ik"]])
def test_the_better_one_comes_first_whatever_the_order(order):
    wins = {"reach_ik": range(400), "reach_ppo": range(300)}
    assert said({name: wins[name] for name in order}).startswith("reach_ik is better than reach_ppo: success +25.0")


def test_equivalence_is_a_claim_of_its_own():
    alike = {"reach_ik": range(398), "reach_ppo": range(397)}
    assert said(alike).startswith("reach_ik and reach_ppo are equivalent in success within 2 points: +0.2 points [")
    assert said(alike, margin=0.001).startswith("Undecided between reach_ik and reach_ppo")
    assert "is better than reach_ppo, but by less than 10 points" in said(
        {"reach_ik": range(400), "reach_ppo": range(390)}, margin=0.1
    )


def test_an_undecided_verdict_says_how_many_episodes_would_tell():
    text = said({"reach_ik": range(50), "reach_ppo": range(48)}, episodes=50)
    assert text.startswith("Undecided between reach_ik and reach_ppo: success +4.0 points [")
    share = 3 / 52  # by Laplace's rule
    needed = max(episodes_to_detect(0.02, share, tests=2), episodes_to_show_equivalence(0.02, share)) - 50
    assert needed - 50 > episodes_to_detect(0.02, share)  # success and return are two tests
    assert f"To resolve a 2-point difference, run about {round(needed, 1 - len(str(needed))):,} more episodes." in text


def test_a_baseline_is_held_against_all_others():
    wins = {"reach_ik": range(400), "reach_ppo": range(300), "random": []}
    text = said(wins, baseline="random")
    assert "reach_ik is better than random" in text
    assert "reach_ppo is better than random" in text
    assert "(Holm, 4 tests)" in text
    assert "reach_ik is better than reach_ppo" not in text


def test_a_policy_of_ones_own_is_always_named():
    wins = {"reach_ik": range(400), "reach_ppo": range(300), "mine.py:pd": range(200), "mine.json": range(100)}
    text = said(wins)
    assert text.startswith("reach_ik is better than reach_ppo")
    assert "reach_ik is better than mine.py:pd" in text
    assert "reach_ik is better than mine.json" in text


def quick_and_slow(gap, episodes=500):
    """Two policies that win all episodes, one of them so many steps faster in each."""
    won = dict.fromkeys(("reach_ppo", "reach_mpc"), np.ones(episodes, dtype=bool))
    pace = np.random.default_rng(0).integers(10, 30, episodes).astype(float)
    return compared(won, {"reach_mpc": pace, "reach_ppo": pace + gap})


def test_where_success_does_not_differ_the_steps_are_told():
    text = text_of(*quick_and_slow(26.0))
    assert re.match(
        r"reach_mpc and reach_ppo are equivalent in success within 2 points: \+0\.0 points \[-0\.7, 0\.7\]; "
        r"reach_mpc takes 26\.0 \[25\.\d, 26\.\d\] fewer steps, p = 0\.0015 \(Holm, 3 tests\)\. "
        r"Median decision time",
        text,
    ), text
    same = text_of(*quick_and_slow(0.0))
    assert "fewer steps" not in same
    assert same.startswith(
        "reach_mpc and reach_ppo are equivalent in success within 2 points: +0.0 points [-0.7, 0.7]. "
    )


def test_an_interval_beyond_the_margin_does_not_contradict_equivalence():
    alike = {name: range(200) for name in ("reach_ik", "reach_ppo", "reach_bc")}
    assert "are equivalent in success within 2 points (two one-sided tests at 5 %): +0.0 points [-2.2, 2.2]" in said(
        alike, 200
    )
    alike.pop("reach_bc")
    assert "are equivalent in success within 2 points: +0.0 points [-1.8, 1.8]" in said(alike, 200)


def test_steps_are_told_of_the_undecided_and_not_of_a_winner():
    fast, slow = np.full(50, 10.0), np.full(50, 30.0)
    undecided = text_of(
        *played({"reach_ik": range(50), "reach_ppo": range(48)}, 50, {"reach_ik": fast, "reach_ppo": slow})
    )
    assert re.match(
        r"Undecided between reach_ik and reach_ppo: success \+4\.0 points \[-\d\.\d, 13\.\d\], p = 0\.95 "
        r"\(Holm, 3 tests\); reach_ik takes 22\.8 \[13\.8, 29\.9\] fewer steps, p = 0\.0015\. Median .*\. "
        r"To resolve a 2-point difference, run about [\d,]+ more",
        undecided,
    ), undecided
    better = text_of(
        *played({"reach_ik": range(50), "reach_ppo": range(20)}, 50, {"reach_ik": fast, "reach_ppo": slow})
    )
    assert better.startswith("reach_ik is better than reach_ppo: success +60.0 points [")
    assert "fewer steps" not in better


def test_the_faster_one_may_be_the_one_of_less_success():
    fast, slow = np.full(50, 10.0), np.full(50, 40.0)
    text = text_of(*played({"reach_ik": range(50), "reach_ppo": range(48)}, 50, {"reach_ik": slow, "reach_ppo": fast}))
    assert text.startswith("Undecided between reach_ik and reach_ppo: success +4.0 points [")
    assert "; reach_ppo takes 26.4 [" in text


def test_earlier_looks_are_a_part_of_the_sentence():
    once, twice = [100], [100, 1200]
    words = "after 2 earlier looks at 100 and 1,200 episodes, p is too small and intervals are too narrow"
    for ppo in (300, 399, 396):
        policies, pairs = played({"reach_ik": range(400), "reach_ppo": range(ppo)})
        plain, looked = text_of(policies, pairs), text_of(policies, pairs, looks=twice)
        assert f"; {words}." in looked
        assert looked.replace(f"; {words}", "") == plain
        assert verdict(policies, pairs, looks=twice).result.endswith(f"; {words}.")
        assert "; after an earlier look at 100 episodes, p is too small" in verdict(policies, pairs, looks=once).result


def test_without_bounds_of_returns_the_sign_test_speaks():
    returns = {"bold": np.where(np.arange(100) < 71, 1.0, -500.0), "timid": np.zeros(100)}
    pair = difference_between("bold", "timid", Scores(None, (returns["bold"], returns["timid"]), None, (-500.0, 1.0)))
    unknown = dataclasses.replace(
        pair, return_p=None, return_difference=dataclasses.replace(pair.return_difference, low=None, high=None),
        simultaneous=dataclasses.replace(pair.simultaneous, returns=Estimate(-144.3, None, None)),
    )  # fmt: skip
    summaries = [
        dataclasses.replace(
            summary_of(name, np.ones(100, dtype=bool)), success=None, episode_return=Estimate(mean, None, None)
        )
        for name, mean in (("bold", -144.3), ("timid", 0.0))
    ]
    sentence = "bold has the higher return in 71 % [61, 80] of episodes (sign test, p = 3.2e-05; ties count half)"
    for policies, pairs in ((summaries, [unknown]), (summaries[::-1], [unknown])):
        assert verdict(policies, pairs).result == f"{sentence}."
        looked = verdict(policies, pairs, looks=[50]).result
        assert looked.startswith(f"{sentence}; after an earlier look at 50 episodes, p is")
    even = np.where(np.arange(100) < 55, 1.0, -500.0)
    close = difference_between("timid", "bold", Scores(None, (returns["timid"], even), None, (-500.0, 1.0)))
    text = text_of(summaries, [dataclasses.replace(close, return_p=None)])
    assert text.startswith(
        "Undecided between bold and timid: bold has the higher return in 55 % [45, 65] of episodes (sign"
    )
    assert "earns" not in text_of(summaries, [unknown])
    third = difference_between("bold", "third", Scores(None, (returns["bold"], returns["timid"])))
    among = [unknown, third, difference_between("timid", "third", Scores(None, (returns["timid"],) * 2))]
    best = dataclasses.replace(summaries[0], episode_return=Estimate(1.0, None, None))
    text = text_of([best, summaries[1], dataclasses.replace(summaries[1], policy="third")], among)
    assert text.startswith("bold has the higher return in 71 % [")
    assert "of episodes (sign test, p = 9.6e-05 (Holm, 3 pairs); ties count half)." in text


def test_a_share_just_above_one_half_is_told_as_shown():
    won = np.where(np.arange(1000) < 532, 1.0, -1.0)
    pair = difference_between("bold", "timid", Scores(None, (won, np.zeros(1000)), None, (-1.0, 1.0)))
    summaries = [
        dataclasses.replace(summary_of(name, np.ones(1000, dtype=bool)), success=None) for name in ("bold", "timid")
    ]
    told = text_of(summaries, [dataclasses.replace(pair, return_p=None)])
    assert told.startswith("bold has the higher return in 53 % [50, 56] of episodes (sign test, p = 0.0")


def test_whoever_earns_more_is_told_also_if_the_other_wins_more_often():
    returns = {"reach_ik": np.full(400, 0.4), "reach_ppo": np.full(400, 0.7)}
    wins = {"reach_ik": range(400), "reach_ppo": range(398)}
    for names in (wins, dict(reversed(wins.items()))):
        text = text_of(*played({name: wins[name] for name in names}, returns={name: returns[name] for name in names}))
        assert "reach_ik and reach_ppo are equivalent in success" in text
        assert " reach_ppo earns 0.3 [0." in text
        assert " more return per episode than reach_ik, p = " in text


@pytest.mark.parametrize(
    ("worlds", "said"),
    [((1, 1), "."), ((4, 4), " (shares of a batch of 4 worlds)."),
     ((1, 4), " (latencies, shares of a batch of 4 worlds).")],
)  # fmt: skip
def test_the_cost_says_what_decision_times_are(worlds, said):
    summaries, pairs = played({"reach_ik": range(400), "reach_ppo": range(300)})
    summaries = [dataclasses.replace(one, worlds=n) for one, n in zip(summaries, worlds, strict=True)]
    assert verdict(summaries, pairs).cost.endswith(f" after 1.5 million decisions of training{said}")


def test_a_baseline_must_take_part():
    with pytest.raises(ConfigurationError, match=r"no baseline among the compared policies 'reach_ki'.*reach_ik"):
        armctl.compare(["reach_ik"], episodes=1, baseline="reach_ki")
    with pytest.raises(ConfigurationError, match="margin"):
        armctl.compare(["reach_ik"], episodes=1, margin=2)


class FailsAtOnce(HoldsStill):
    def __init__(self, env):
        pass

    def act(self, observations):
        raise ArithmeticError("no luck")


def test_a_baseline_that_failed_leaves_the_verdict_to_the_others():
    failing = f"{__name__}:FailsAtOnce"
    made = armctl.compare(["reach_ik", "random", failing], episodes=10, worlds=10, baseline=failing)
    assert "no luck" in made.failures[failing]
    assert made.verdict.result.startswith("reach_ik is better than random")


def test_baseline_and_margin_survive_in_the_folder(tmp_path):
    from armctl.study.results import read_comparison

    made = armctl.compare(["reach_ik", "random"], episodes=10, worlds=10, out=tmp_path, baseline="random", margin=0.1)
    read = read_comparison(tmp_path)
    assert (read.facts.baseline, read.facts.margin, read.verdict) == ("random", 0.1, made.verdict)
