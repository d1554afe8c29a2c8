"""Who holds out against what, from the rows of a sweep."""

import math

import numpy as np
import pandas as pd
import pytest

from armctl.evaluation.endurance import endurance_headline, endurances
from armctl.evaluation.statistics import success_rate

N = 50


def points(wins, levels=(0.0, 1.0, 2.0), episodes=N, counted=True):
    """Rows of a sweep in which each policy wins so many of `episodes` at each level, by disturbance."""
    rows = []
    for disturbance, policies in wins.items():
        for i, level in enumerate(levels):
            for policy, won in policies.items():
                rate = success_rate(np.arange(episodes) < won[i])
                rows.append((disturbance, level, policy, episodes, rate.value, rate.low, rate.high, "steps"))
    columns = ["disturbance", "level", "policy", "episodes", "success", "low", "high", "unit"]
    return pd.DataFrame(rows, columns=columns).drop(columns=[] if counted else "episodes")


@pytest.mark.parametrize("counted", [True, False])
def test_the_leader_and_from_where_others_fall_behind(counted):
    (delay,) = endurances(
        points({"delay": {"agent": (50, 48, 10), "planner": (50, 50, 46), "random": (0, 1, 0)}}, counted=counted)
    )
    assert (delay.leaders, delay.behind, delay.from_the_start) == (["planner"], {"agent": 2.0}, ["random"])
    assert str(delay) == (
        "Against delay, planner holds out longest: at 2 (steps), planner 92 % [81, 98], agent 20 % [10, 34]. "
        "agent falls behind from 2 on; random is behind undisturbed already."
    )


def test_chance_makes_nobody_a_leader():
    close = {"a": (50, 48, 44), "b": (50, 47, 46)}
    (noise,) = endurances(points({"noise": close}))
    assert (noise.leaders, noise.behind) == (["b", "a"], {})
    assert "b and a cannot be told apart: at 2 (steps)" in str(noise)
    assert endurance_headline([noise]) == "Under noise, nobody is shown to fall behind."


def test_whoever_recovers_has_not_fallen_behind():
    (noise,) = endurances(points({"noise": {"a": (50, 50, 40), "b": (50, 5, 42)}}))
    assert (noise.leaders, noise.behind) == (["a", "b"], {})


def test_the_order_may_turn():
    (noise,) = endurances(points({"noise": {"a": (50, 20, 5), "b": (35, 35, 35)}}))
    assert (noise.leaders, noise.behind) == (["b"], {"a": 1.0})


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
    assert endurances(points(noise, levels=(0.0, 1.0)))[0].behind == {"b": 1.0}
    assert endurances(points(noise | many, levels=(0.0, 1.0)))[0].behind == {}


def test_returns_must_have_intervals_apart():
    table = points({"noise": {"a": (1, 1, 1), "b": (1, 1, 1)}})
    middle = [10.0, 10, 10, 4, 10, 2]
    table = table.assign(success=math.nan, **{"return": middle})
    table = table.assign(return_low=table["return"] - [1, 1, 1, 6, 1, 1], return_high=table["return"] + 1.0)
    (noise,) = endurances(table)
    assert noise.behind == {"b": 1.0}
    assert "a 10.0 [9.0, 11.0], b 2.0 [1.0, 3.0]" in str(noise)


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
