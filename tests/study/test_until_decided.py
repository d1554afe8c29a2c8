"""Comparisons that stop when their verdict is decided: the same episodes as of a fixed number, only fewer."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.study import compare
from armctl.study.plan import comparison_plan
from armctl.study.results import read_comparison

from ..printed import text_of
from ..stores import timeless

SHORT: Any = {"max_episode_steps": 12}
PLAYED: Any = {"policies": ["random", "reach_ik"], "env_options": SHORT, "policy_seed": 1}
UNTIL: Any = {**PLAYED, "until": "decided", "episodes": 60}
HOLDS = "p and intervals hold at any number of episodes"


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stopped")
    return compare(**UNTIL, out=folder), folder


def test_it_stops_early_and_says_so(stopped):
    comparison, folder = stopped
    n = comparison.facts.planned
    assert 10 <= n < 60
    assert comparison.results.column("episode").max() == n - 1
    assert (comparison.facts.at_most, comparison.stopped_of) == (60, 60)
    result = comparison.verdict.result
    assert result.startswith("reach_ik is better than random: success +")
    assert result.endswith(f"; stopped after {n} of at most 60 episodes: {HOLDS}.")
    text = " ".join(text_of(comparison).split())
    assert "cut short" not in text
    assert "Intervals of single policies are for a fixed number" in text
    assert json.loads((folder / "summary.json").read_text())["at_most"] == 60
    assert read_comparison(folder).verdict == comparison.verdict


def test_its_episodes_are_those_of_a_fixed_number(stopped, tmp_path):
    comparison, folder = stopped
    compare(**PLAYED, episodes=comparison.facts.planned, out=tmp_path)
    assert timeless(folder).equals(timeless(tmp_path))


@pytest.mark.parametrize("setting", [{"worlds": 7}, pytest.param({"workers": 2, "worlds": 2}, marks=pytest.mark.slow)])
def test_worlds_and_workers_change_neither_episodes_nor_their_number(stopped, tmp_path, setting):
    compare(**UNTIL, **setting, out=tmp_path)
    assert timeless(tmp_path).equals(timeless(stopped[1]))


@pytest.mark.parametrize("number", [1, 12, 25])
def test_an_interrupted_one_goes_on_and_stops_where_it_would_have(stopped, tmp_path, number):
    played = []

    def interrupt(result):
        played.append(result)
        if len(played) == number:
            raise KeyboardInterrupt

    first = compare(**UNTIL, out=tmp_path, progress=interrupt)
    assert first.interrupted
    assert first.facts.planned == 60
    second = compare(**UNTIL, out=tmp_path)
    assert second.facts.planned == stopped[0].facts.planned
    assert second.verdict.result == stopped[0].verdict.result
    assert timeless(tmp_path).equals(timeless(stopped[1]))


def test_the_same_command_plays_nothing_more_after_it_stopped(stopped):
    comparison, folder = stopped
    again = compare(**UNTIL, out=folder)
    assert again.resumed == len(comparison.results) == len(again.results)
    assert again.verdict.result == comparison.verdict.result


def test_without_a_decision_all_are_played():
    alike = compare({"a": "random", "b": "random"}, env_options=SHORT, until="decided", episodes=13)
    assert (alike.facts.planned, alike.stopped_of, len(alike.results)) == (13, None, 26)
    assert alike.verdict.result.startswith("Undecided between ")
    assert alike.verdict.result.endswith(f"; {HOLDS}.")


def test_policies_that_are_equivalent_are_decided_too():
    alike = compare({"a": "random", "b": "random"}, env_options=SHORT, until="decided", episodes=60, margin=0.3)
    assert alike.facts.planned < 60
    assert " are equivalent in success within 30 points" in alike.verdict.result


def test_a_comparison_with_an_earlier_look_holds_at_any_number_too(tmp_path):
    alike: Any = {"policies": {"a": "random", "b": "random"}, "env_options": SHORT, "out": tmp_path}
    first = compare(**alike, episodes=10)
    assert not first.differences[0].any_number
    second = compare(**alike, episodes=20)
    assert second.looks == [10]
    assert second.differences[0].any_number
    assert second.verdict.result.endswith(f"; {HOLDS}.")
    assert "too small" not in str(second.verdict)
    assert read_comparison(tmp_path).verdict == second.verdict
    third = compare(**alike, episodes=40, until="decided", margin=0.3)
    assert third.facts.planned < 40


def test_looks_at_episodes_that_were_overwritten_are_named(tmp_path):
    alike: Any = {"policies": {"a": "random", "b": "random"}, "env_options": SHORT, "out": tmp_path}
    compare(**alike, episodes=10)
    second = compare(**alike, episodes=20, overwrite=True)
    assert (second.looks, second.differences[0].any_number) == ([10], False)
    assert second.verdict.result.endswith("p is too small and intervals are too narrow.")
    third = compare(**alike, episodes=30)
    assert (third.looks, third.differences[0].any_number) == ([10, 20], True)
    assert third.verdict.result.endswith("p is too small and intervals are too narrow.")


def test_a_look_that_decided_already_ends_it_at_once(tmp_path):
    compare(**PLAYED, episodes=33, out=tmp_path)
    comparison = compare(**UNTIL, out=tmp_path)
    assert comparison.facts.planned == 33
    assert "stopped after 33 of at most 60 episodes" in comparison.verdict.result


def fails(observation):
    raise ValueError("always")


def test_a_policy_that_cannot_play_does_not_hold_up_the_others():
    comparison = compare({"bad": fails, "random": "random", "reach_ik": "reach_ik"}, env_options=SHORT, until="decided",
                         episodes=40)  # fmt: skip
    assert "bad" in comparison.failures
    assert comparison.facts.planned < 40
    assert comparison.verdict.result.startswith("reach_ik is better than random")


@pytest.mark.parametrize(
    ("policies", "options", "words"),
    [
        (["random"], {}, "random plays alone"),
        (["reach_ik", "reach_bc[*]"], {}, "of groups of trainings, no method holds at any number"),
        (["random", "reach_ik"], {"until": "decidet"}, "Did you mean 'decided'"),
    ],
)
def test_what_cannot_stop_early_is_refused(policies, options, words):
    with pytest.raises(ConfigurationError, match=words):
        comparison_plan(policies, "armctl/ArmReach-v0", 20, 0, {"until": "decided", **options})  # type: ignore[typeddict-item]


def test_blocks_do_not_depend_on_where_a_run_ended():
    plan = comparison_plan(["random", "reach_ik"], "armctl/ArmReach-v0", 100, 0, {"until": "decided"})
    assert plan.block_ends(0, [])[:3] == [10, 20, 30]
    assert plan.block_ends(11, []) == plan.block_ends(0, [])[1:]
    assert plan.block_ends(25, [25])[0] == 25
    assert plan.block_ends(100, [100]) == [100]
    fixed = dataclasses.replace(plan, until_decided=False)
    assert fixed.block_ends(7, [3]) == [100]
    assert np.all(np.diff(plan.block_ends(0, [])) > 0)
