"""Who holds out against what, from the rows of a sweep."""

import math

import numpy as np
import pandas as pd
import pytest

from armctl.evaluation.degradation import Onset
from armctl.evaluation.endurance import NEUTRAL, PairTest, endurance_headline
from armctl.evaluation.endurance import endurances as endurances_of
from armctl.evaluation.paired import mcnemar
from armctl.evaluation.statistics import success_rate

N = 50


def endurances(table, pairs=None):
    """As for a sweep of an older version, unless there are `pairs`."""
    return endurances_of(table, pairs or {})


def points(wins, levels=(0.0, 1.0, 2.0), episodes=N, counted=True):
    """Rows of a sweep in which each policy wins so many of `episodes` at each level, by disturbance."""
    rows = []
    for disturbance, policies in wins.items():
        for i, level in enumerate(levels):
            for policy, won in policies.items():
                rate = success_rate(np.arange(episodes) < won[i])
                p = mcnemar(max(won[0] - won[i], 0), max(won[i] - won[0], 0))
                rows.append((disturbance, level, policy, episodes, rate.value, rate.low, rate.high, p, "steps"))
    columns = ["disturbance", "level", "policy", "episodes", "success", "low", "high", "p", "unit"]
    return pd.DataFrame(rows, columns=columns).drop(columns=[] if counted else "episodes")


@pytest.mark.parametrize("counted", [True, False])
def test_the_leader_and_from_where_others_fall_behind(counted):
    (delay,) = endurances(
        points({"delay": {"agent": (50, 48, 10), "planner": (50, 50, 46), "random": (0, 1, 0)}}, counted=counted)
    )
    assert (delay.leaders, delay.behind, delay.from_the_start) == (["planner"], {"agent": Onset(2.0)}, ["random"])
    assert str(delay) == (
        "Against delay, planner holds out longest: at 2 (steps), planner 92 % [81, 98], agent 20 % [10, 34], "
        "random 0 % [0, 7]. agent falls behind from 2 on; random is behind undisturbed already."
    )


def test_chance_makes_nobody_a_leader():
    close = {"a": (50, 48, 44), "b": (50, 47, 46)}
    (noise,) = endurances(points({"noise": close}))
    assert (noise.leaders, noise.behind) == (["b", "a"], {})
    assert "no difference is shown between b and a: at 2 (steps)" in str(noise)
    assert endurance_headline([noise]) == "Under noise, nobody is shown to fall behind."


def test_whoever_recovers_was_behind_all_the_same():
    (noise,) = endurances(points({"noise": {"a": (50, 50, 40), "b": (50, 5, 42)}}))
    assert (noise.leaders, noise.behind) == (["a"], {"b": Onset(1.0, lasts=False)})
    assert str(noise).endswith("b falls behind at 1.")


def test_a_later_tie_does_not_undo_a_defeat():
    (delay,) = endurances(points({"delay": {"ik": (100, 100, 0), "ppo": (100, 50, 0)}}, episodes=100))
    assert (delay.leaders, delay.behind) == (["ik"], {"ppo": Onset(1.0)})
    assert endurance_headline([delay]) == "ik is ahead under delay."


@pytest.mark.parametrize(
    ("wins", "told", "headline"),
    [
        ({"ik": (100, 100), "random": (1, 1)}, "ik holds out longest", "ik holds out longest against noise."),
        ({"ik": (100, 5), "random": (0, 0)}, "ik is ahead", "ik is ahead under noise."),
    ],
)
def test_whoever_gets_worse_does_not_hold_out(wins, told, headline):
    (noise,) = endurances(points({"noise": wins}, levels=(0.0, 1.0), episodes=100))
    assert noise.from_the_start == ["random"]
    assert str(noise).startswith(f"Against noise, {told}: at 1")
    assert endurance_headline([noise]) == headline


def test_the_same_episodes_decide_where_they_are_known():
    """25 against 17 of 50 is chance for Fisher's test, but not if the one wins all that the other wins, and 8 more."""
    table = points({"noise": {"a": (50, 25), "b": (50, 17)}}, levels=(0.0, 1.0))
    both = frozenset(("a", "b"))
    assert endurances(table)[0].behind == {}
    tests = {(*NEUTRAL, both): PairTest(1.0, 0.0), ("noise", 1.0, both): PairTest(mcnemar(8, 0), 8 / 50)}
    assert endurances(table, tests)[0].behind == {"b": Onset(1.0)}
    other = points({"noise": {"a": (50, 50), "b": (50, 42)}}, levels=(0.0, 1.0))
    assert endurances(other)[0].behind == {"b": Onset(1.0)}
    tests["noise", 1.0, both] = PairTest(0.2, 8 / 50)
    assert endurances(other, tests)[0].behind == {}


def test_several_trainings_are_not_one_network():
    """Their interval is over trainings, so that it is wider than that of as many episodes."""
    table = points({"noise": {"a": (50, 50), "b[*]": (50, 42)}}, levels=(0.0, 1.0))
    table.loc[table.policy == "b[*]", ["low", "high"]] = 0.1, 1.0
    assert endurances(table)[0].behind == {}


def test_the_undisturbed_level_counts_once():
    """However many disturbances there are: copies of a proven difference would excuse a chance one elsewhere."""
    names = [f"noise {i}" for i in range(8)]
    table = points({name: {"a": (50, 50), "b": (10, 50), "c": (50, 50)} for name in names}, levels=(0.0, 1.0))
    table.loc[(table.disturbance == names[0]) & (table.policy == "c") & (table.level == 1), "success"] = 0.9
    pairs = {(name, 1.0, frozenset(two)): PairTest(1.0, 0.0) for name in names for two in ("ab", "ac", "bc")}
    lead = {"ab": 0.8, "ac": 0.0, "bc": -0.8}
    pairs |= {(*NEUTRAL, frozenset(two)): PairTest(0.0 if "b" in two else 1.0, lead[two]) for two in lead}
    pairs[names[0], 1.0, frozenset("ac")] = PairTest(0.01, 0.1)
    found = endurances(table, pairs)
    assert all("c" in one.leaders and one.behind == {} for one in found)
    assert all("b" in one.behind or "b" in one.from_the_start for one in found)


def test_the_order_may_turn():
    (noise,) = endurances(points({"noise": {"a": (50, 20, 5), "b": (35, 35, 35)}}))
    assert (noise.leaders, noise.behind) == (["b"], {"a": Onset(1.0)})


def test_one_sentence_over_all_disturbances():
    better, worse, same = (50, 50, 50), (50, 10, 5), (50, 50, 49)
    found = endurances(
        points(
            {
                "noise": {"a": better, "b": worse},
                "delay": {"a": better, "b": worse},
                "pushes": {"a": worse, "b": better},
                "payload": {"a": same, "b": better},
            }
        )
    )
    assert endurance_headline(found) == (
        "a holds out longest against noise and delay; b holds out longest against pushes; "
        "under payload, nobody is shown to fall behind."
    )


def test_many_levels_are_corrected_for():
    """p is 0.006 in one row: enough among two levels, and not among 21 without any difference."""
    noise = {"noise": {"a": (50, 50), "b": (50, 42)}}
    many = {f"other {i}": {"a": (50, 50), "b": (50, 50)} for i in range(20)}
    assert endurances(points(noise, levels=(0.0, 1.0)))[0].behind == {"b": Onset(1.0)}
    assert endurances(points(noise | many, levels=(0.0, 1.0)))[0].behind == {}


def test_returns_go_by_the_sign_test_and_never_by_means():
    """b has the higher return in most episodes, and the lower mean, because it has disasters."""
    table = points({"noise": {"a": (1, 1, 1), "b": (1, 1, 1)}})
    table = table.assign(success=math.nan, **{"return": [10.0, 10, 10, 4, 10, 2]})
    unknown = table.assign(return_low=math.nan, return_high=math.nan)
    both = frozenset("ab")
    tests = {(*NEUTRAL, both): PairTest(1.0, 0.0), ("noise", 1.0, both): PairTest(0.3, -0.1)}
    tests["noise", 2.0, both] = PairTest(1e-9, -0.9)
    (noise,) = endurances(unknown, tests)
    assert (noise.leaders, noise.behind) == (["b"], {"a": Onset(2.0)})
    assert "b 2.0, a 10.0" in str(noise)
    bounded = table.assign(return_low=table["return"] - 1.0, return_high=table["return"] + 1.0)
    assert "b 2.0 [1.0, 3.0], a 10.0 [9.0, 11.0]" in str(endurances(bounded, tests)[0])
    for older in (unknown, bounded):  # an older version's sweep has no tests, and its intervals did not hold
        (noise,) = endurances(older)
        assert (set(noise.leaders), noise.behind) == ({"a", "b"}, {})


@pytest.mark.parametrize(
    "spoilt",
    [
        {"success": 7.0},
        {"success": math.inf},
        {"success": math.nan},
        {"episodes": -3},
        {"episodes": 10**18},
        {"episodes": "many"},
        {"level": math.nan},
        {"level": -math.inf},
        {"low": math.nan},
        {"unit": math.nan},
        {"policy": "a"},
        {"p": math.nan},
        {"p": -7.0},
        {"p": "small"},
    ],
)
def test_a_strangers_table_gives_no_traceback(spoilt):
    table = points({"noise": {"a": (50, 50, 40), "b": (50, 40, 10)}}).astype(object)
    for name, value in spoilt.items():
        table.loc[3, name] = value
        whole = table.assign(**{name: value})
        for one in (table, whole):
            endurance_headline(endurances(one.infer_objects()))


def test_without_a_disturbed_level_there_is_nothing_to_say():
    assert endurances(points({"noise": {"a": (50,), "b": (40,)}}, levels=(0.0,))) == []
    assert endurance_headline([]) == ""
