"""Comparisons that stop when their verdict is decided: the same episodes as of a fixed number, only fewer."""

import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.report import write_report
from armctl.stats.across_tasks import TaskPair
from armctl.stats.difference import MARGIN
from armctl.stats.robustness import change_between
from armctl.stats.sequential import ConfidenceSequence
from armctl.study import compare, suite, sweep
from armctl.study.line_up import line_up
from armctl.study.plan import comparison_plan, sweep_plan
from armctl.study.results import read_comparison, read_study
from armctl.study.suite_plan import suite_plan
from armctl.verdict.summary import counted_rows

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


@pytest.mark.slow
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


@pytest.mark.slow
def test_without_a_decision_all_are_played():
    alike = compare({"a": "random", "b": "random"}, env_options=SHORT, until="decided", episodes=13)
    assert (alike.facts.planned, alike.stopped_of, len(alike.results)) == (13, None, 26)
    assert alike.verdict.result.startswith("Undecided between ")
    assert alike.verdict.result.endswith(f"; {HOLDS}.")


def test_policies_that_are_equivalent_are_decided_too():
    alike = compare({"a": "random", "b": "random"}, env_options=SHORT, until="decided", episodes=60, margin=0.3)
    assert alike.facts.planned < 60
    assert " are equivalent in success within 30 points" in alike.verdict.result


@pytest.mark.slow
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


@pytest.mark.slow
def test_looks_at_episodes_that_were_overwritten_are_named(tmp_path):
    alike: Any = {"policies": {"a": "random", "b": "random"}, "env_options": SHORT, "out": tmp_path}
    compare(**alike, episodes=10)
    second = compare(**alike, episodes=20, overwrite=True)
    assert (second.looks, second.differences[0].any_number) == ([10], False)
    assert second.verdict.result.endswith("p is too small and intervals are too narrow.")
    third = compare(**alike, episodes=30)
    assert (third.looks, third.differences[0].any_number) == ([10, 20], True)
    assert third.verdict.result.endswith("p is too small and intervals are too narrow.")


@pytest.mark.slow
def test_a_look_that_decided_already_ends_it_at_once(tmp_path):
    compare(**PLAYED, episodes=33, out=tmp_path)
    comparison = compare(**UNTIL, out=tmp_path)
    assert comparison.facts.planned == 33
    assert "stopped after 33 of at most 60 episodes" in comparison.verdict.result


def fails(observation):
    raise ValueError("always")


@pytest.mark.slow
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
    (cell,) = plan.cells
    assert plan.block_ends(cell, 0, [])[:3] == [10, 20, 30]
    assert plan.block_ends(cell, 11, []) == plan.block_ends(cell, 0, [])[1:]
    assert plan.block_ends(cell, 25, [25])[0] == 25
    assert plan.block_ends(cell, 100, [100]) == [100]
    fixed = dataclasses.replace(plan, until_decided=False)
    assert fixed.block_ends(cell, 7, [3]) == [100]
    assert np.all(np.diff(plan.block_ends(cell, 0, [])) > 0)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swept")
    return sweep(**UNTIL, disturbances={"noise": [0.01, 0.02]}, worlds=10, out=folder), folder


@pytest.mark.slow
def test_each_level_of_a_sweep_stops_by_itself(swept):
    found, folder = swept
    numbers = [comparison.facts.planned for comparison in found.comparisons.values()]
    assert len(numbers) == 3
    assert 10 < min(numbers) < 60  # later than alone: corrected for three levels
    assert found.any_number
    assert found.looks == []
    again = sweep(**UNTIL, disturbances={"noise": [0.01, 0.02]}, out=folder)
    assert again.points.equals(found.points)
    assert len(again.undisturbed.results) == again.undisturbed.resumed


@pytest.mark.slow
def test_changes_of_a_sweep_are_tested_at_any_number(swept):
    found, _ = swept
    points = found.points.set_index(["level", "policy"])
    rows = [counted_rows(found.comparisons[name].results) for name in ("none", "noise-0.02")]
    first, second = (of[of.policy == "reach_ik"] for of in rows)
    expected = change_between(first, second, "success", any_number=True)
    assert tuple(points.loc[(0.02, "reach_ik"), ["p", "change"]]) == expected
    worse = second.assign(success=0.0)
    assert change_between(first, worse, "success", any_number=True)[0] > change_between(first, worse, "success")[0]


@pytest.fixture(scope="module")
def stopped_suite(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("armctl.study.suite_plan.line_up", lambda env, one_of_each: ("random", "reach_ik", "reach_ppo"))
        patch.setattr("armctl.study.suite_plan.main_disturbances", lambda env, size: {"delay": [0, 20]})
        yield suite(["armctl/ArmReach-v0"], episodes=60, until="decided", worlds=10, out=folder), folder


@pytest.mark.slow
def test_a_suite_stops_where_its_own_verdict_is_decided(stopped_suite):
    found, folder = stopped_suite
    (verdict,) = found.verdicts
    assert verdict.classical.of_several
    assert verdict.classical.policy == "reach_ik"
    plain, delayed = (comparison.facts.planned for comparison in found.cells.values())
    assert plain == 60  # equivalent, which so few episodes do not show
    assert delayed < 60  # by far not equivalent
    assert verdict.undisturbed.episodes == 60 - 30
    assert verdict.pairs["delay-20.0"].better == 1
    assert "by a test that holds at any number of them" in verdict.verdict
    text = " ".join(text_of(found).split())
    assert "at most 60 episodes" in text
    assert "the first 30 undisturbed episodes select the best, and only later ones evaluate it" in text
    assert [str(one.verdict) for one in read_study(folder).verdicts] == [verdict.verdict]
    assert "--until decided --at-most 60" in write_report(folder).read_text()


@pytest.mark.slow
def test_who_represents_no_kind_stops_earlier_and_all_count(stopped_suite, tmp_path, monkeypatch):
    found, folder = stopped_suite
    counts = {
        name: {policy: len(table) for policy, table in cell.results.by_policy().items()}
        for name, cell in found.cells.items()
    }
    plain, delayed = counts.values()
    assert plain["reach_ik"] == plain["reach_ppo"] == 60
    assert plain["random"] == 30 + 10
    assert delayed == {"random": 10, "reach_ik": 20, "reach_ppo": 20}
    counted = found.cells["ArmReach-v0/delay-20.0"].counted
    assert {int(table.column("episode").min()) for table in counted.values()} == {30}  # those before made the choice
    points = found.tasks["armctl/ArmReach-v0"].points.set_index(["level", "policy"])
    assert points.loc[(20.0, "random"), "episodes"] == 10
    assert np.isfinite(points.loc[(20.0, "random"), "change"])
    text = " ".join(text_of(found.cells["ArmReach-v0/none"]).split())
    assert "Stopped earlier, as they represent no kind: random." in text
    assert "cut short" not in text
    monkeypatch.setattr("armctl.study.suite_plan.line_up", lambda env, one_of_each: ("random", "reach_ik", "reach_ppo"))
    monkeypatch.setattr("armctl.study.suite_plan.main_disturbances", lambda env, size: {"delay": [0, 20]})
    played = []

    def interrupt(*result):
        played.append(result)
        if len(played) == 115:  # in the undisturbed cell, after the choice
            raise KeyboardInterrupt

    options = {"episodes": 60, "until": "decided", "worlds": 10, "out": tmp_path}
    assert suite(["armctl/ArmReach-v0"], progress=interrupt, **options).interrupted
    resumed = suite(["armctl/ArmReach-v0"], **options)
    assert [str(one.verdict) for one in resumed.verdicts] == [str(one.verdict) for one in found.verdicts]
    assert timeless(tmp_path).equals(timeless(folder))


@pytest.mark.slow
def test_a_task_with_one_kind_alone_has_nothing_to_decide(monkeypatch, tmp_path):
    monkeypatch.setattr("armctl.study.suite_plan.line_up", lambda env, one_of_each: ("reach_ik", "reach_rate"))
    monkeypatch.setattr("armctl.study.suite_plan.main_disturbances", lambda env, size: {"delay": [0, 8]})
    found = suite(["armctl/ArmReach-v0"], episodes=60, until="decided", worlds=10, out=tmp_path)
    assert [comparison.facts.planned for comparison in found.cells.values()] == [10, 10]


line_up_once = functools.cache(line_up)  # which makes all policies of a task


@pytest.mark.parametrize("quick", [False, True])
@pytest.mark.parametrize("until", [None, "decided"])
def test_a_suite_stops_unless_a_number_is_fixed(quick, until, monkeypatch):
    monkeypatch.setattr("armctl.study.suite_plan.line_up", line_up_once)
    undisturbed, at_most = (100, 100) if quick else (200, 50)
    options: Any = {"until": until} if until else {}
    for episodes, expected in ((None, (undisturbed, at_most, True)), (7, (7, 7, until is not None))):
        plan = suite_plan(["armctl/ArmReach-v0"], quick, episodes, 0, options)
        first, *disturbed = plan.cells
        (others,) = {plan.episodes_in(cell) for cell in disturbed}
        assert (plan.episodes_in(first), others, plan.until_decided) == expected


def test_a_suite_that_stops_at_something_else_is_refused():
    with pytest.raises(ConfigurationError, match="Did you mean 'decided'"):
        suite_plan(["Pendulum-v1"], True, None, 0, {"until": "decidet"})  # type: ignore[typeddict-item]


@pytest.mark.parametrize(
    ("episodes", "wins", "decided"), [(100, 10, False), (100, 11, True), (287, 0, False), (316, 0, True)]
)
def test_what_a_quick_suite_of_ten_tasks_can_decide(episodes, wins, decided):
    gains = np.zeros(episodes)
    gains[np.linspace(0, episodes - 1, wins, dtype=int)] = 1
    sequence = ConfidenceSequence(gains, (-1.0, 1.0))
    pair = TaskPair(episodes, wins, 0, 2 * 10 * sequence.p(), num_comparisons=10, anytime=sequence.intervals())
    assert bool(pair.better or pair.equivalent(MARGIN)) is decided


@pytest.mark.slow
@pytest.mark.parametrize(("until", "counts"), [(None, {42}), ("decided", {10, 12})])
def test_only_a_suite_that_stops_plays_fewer_episodes_of_some(monkeypatch, until, counts):
    monkeypatch.setattr("armctl.study.suite_plan.line_up", lambda env, one_of_each: ("random", "reach_ik", "reach_ppo"))
    monkeypatch.setattr("armctl.study.suite_plan.main_disturbances", lambda env, size: {"delay": [0, 1]})
    found = suite(["armctl/ArmReach-v0"], episodes=42, until=until, worlds=10)
    assert {len(table) for table in found.cells["ArmReach-v0/delay-1.0"].results.by_policy().values()} == counts


@pytest.mark.slow
def test_a_suite_plays_all_episodes_of_an_environment_that_ignores_its_seed(monkeypatch):
    odd = f"{Path(__file__).parents[1] / 'envs' / 'odd_environments.py'}:Deaf"
    monkeypatch.setattr("armctl.study.suite_plan.line_up", lambda *_: ("random",))
    found = suite([odd], policies={"other": "random"}, episodes=12, until="decided")
    assert not found.problems
    for cell in found.cells.values():
        assert [len(table) for table in cell.results.by_policy().values()] == [12, 12]
        assert (cell.facts.at_most, cell.facts.paired) == (None, False)


def test_looks_take_of_policies_what_summaries_tell(swept):
    for comparison in swept[0].comparisons.values():
        told = [(policy.policy, policy.side, policy.spared) for policy in comparison.policies]
        assert [(name, facts.side, facts.spared) for name, facts in comparison.players.items()] == told


def test_verdicts_that_are_told_together_are_corrected_together(monkeypatch):
    monkeypatch.setattr("armctl.study.suite_plan.line_up", line_up_once)
    reach = ["armctl/ArmReach-v0", "armctl/ArmReachMoving-v0"]
    together = suite_plan(reach, True, 20, 0, {"until": "decided"})
    plain, delayed = together.cells[:2]
    assert (together.num_verdicts_with(plain), together.num_verdicts_with(delayed)) == (2, 1)
    levels = sweep_plan(["random", "reach_ik"], reach[0], {"noise": [0.1, 0.2]}, 9, 0, {"until": "decided"})
    assert [levels.num_verdicts_with(cell) for cell in levels.cells] == [3, 3, 3]
    with pytest.raises(ConfigurationError, match="repeats the times of all episodes"):
        sweep_plan(["random", "reach_ik"], reach[0], {"slow-down": [2]}, 9, 0, {"until": "decided"})
