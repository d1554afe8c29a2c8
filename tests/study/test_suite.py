import contextlib
import importlib
import json
import shutil
import sqlite3

import pandas as pd
import pytest

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.episodes.stored import STORE
from armctl.report.formats import FORMATS
from armctl.report.suite_page import write_suite_page
from armctl.study import suite
from armctl.study.line_up import FULL, QUICK, SuiteSize, line_up, main_disturbances, unusable_agents
from armctl.study.names import task_name
from armctl.study.results import UNFINISHED, read_study
from armctl.study.suite_headline import suite_headline
from armctl.study.suite_plan import suite_plan
from armctl.verdict.tables import Remark, Table

from ..forgery import change_record
from ..stores import timeless

module = importlib.import_module("armctl.study.suite_plan")
REACH, MOVING = "armctl/ArmReach-v0", "armctl/ArmReachMoving-v0"
SMALL = SuiteSize(2, ("delay",), (0.25,))
LINE_UPS = {REACH: ("reach_ik", "reach_ppo", "reach_bc"), MOVING: ("reach_ik", "moving_ppo")}


@pytest.fixture(autouse=True, scope="module")
def small():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "FULL", SMALL)
        patch.setattr(module, "line_up", lambda env, *one_of_each: LINE_UPS.get(env) or line_up(env, *one_of_each))
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    return suite([REACH, MOVING], episodes=2, out=folder), folder


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished[1], tmp_path / "suite")


@pytest.mark.parametrize("size", [FULL, QUICK])
def test_every_task_of_armctl_has_both_kinds_and_main_disturbances(size, monkeypatch):
    for env, other in (("armctl/ArmReachObstacles-v0", "noise_on_state"), ("armctl/BridgeCross-v0", "noise")):
        levels = main_disturbances(env, size)
        assert set(levels) == set(size.disturbances) - {other}
        assert {len(at) for at in levels.values()} == {len(size.levels)}
    monkeypatch.setattr(module, "FULL", size)
    plan = suite_plan([env], False, None, 0, {})
    learned = {"bridge_distil", "bridge_ppo", "bridge_robust_ppo", "bridge_state_ppo"}
    playing = {"bridge_ompl", "bridge_distil"} if size is QUICK else {"bridge_ompl", "bridge_mpc"} | learned
    lines_up = [set(cell.policies) for cell in plan.cells]
    assert all(playing == policies if size is QUICK else playing < policies for policies in lines_up)
    assert len(plan.cells) == 1 + len(levels) * len(size.levels)
    undisturbed, *disturbed = map(len, lines_up)
    assert plan.total == (size.undisturbed_episodes or size.episodes) * undisturbed + size.episodes * sum(disturbed)


@pytest.mark.slow
def test_a_suite_may_play_more_episodes_undisturbed(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "FULL", SuiteSize(2, ("delay",), (0.25,), undisturbed_episodes=4))
    found = suite([MOVING], worlds=4, out=tmp_path)
    assert [cell.facts.at_most for cell in found.cells.values()] == [4, 2]
    assert [len(cell.results) for cell in found.cells.values()] == [8, 4]
    assert read_study(tmp_path).extent == found.extent == "at most 4 episodes undisturbed, 2 in each disturbed setting"
    write_suite_page(found, tmp_path, tmp_path / "suite.html", {})
    page = (tmp_path / "suite.html").read_text()
    assert found.extent in page
    assert "--at-most" not in page


def test_random_actions_play_only_where_there_is_nothing_else():
    assert "random" not in line_up(REACH)
    assert line_up("Pendulum-v1") == ("random",)


@pytest.mark.slow
def test_the_result_is_that_of_sweeps(finished):
    found, folder = finished
    assert set(timeless(folder).cell) == {f"{task}/{at}" for task in ("ArmReach-v0", "ArmReachMoving-v0")
                                          for at in ("none", "delay-1.0")}  # fmt: skip
    alone = armctl.sweep(LINE_UPS[MOVING], MOVING, disturbances={"delay": [1]}, episodes=2)
    swept, by_suite = (one.points.drop(columns=["p"]) for one in (alone, found.tasks[MOVING]))
    pd.testing.assert_frame_equal(swept, by_suite, check_dtype=False)
    assert found.problems == []


@pytest.mark.slow
def test_what_is_read_back_is_what_was_found(finished):
    found, folder = finished
    again = read_study(folder)
    assert [(one.verdict, one.context) for one in again.verdicts] == [
        (one.verdict, one.context) for one in found.verdicts
    ]
    assert [one.pairs for one in again.verdicts] == [one.pairs for one in found.verdicts]
    for one in again.verdicts:
        policies = {policy.policy: policy.restricted_steps.value for policy in one.policies}
        expert, agent = (policies[choice.policy] for choice in (one.classical, one.learned))
        assert one.undisturbed.steps.value == pytest.approx(expert - agent)
    assert again.leagues == found.leagues
    assert repr(again) == repr(found) == "<Study of armctl/ArmReach-v0, armctl/ArmReachMoving-v0, seed 0>"


def test_tables_in_all_formats(finished):
    document = finished[0].document()
    tasks = next(part for part in document.parts if isinstance(part, Table))
    assert [row[0].text for row in tasks.rows] == [REACH, MOVING]
    assert "No verdict from 2 episodes: reach_ik against" in FORMATS["markdown"](document).replace("\\", "")
    assert {one["env"] for one in json.loads(FORMATS["json"](document))["tasks"]} == {REACH, MOVING}
    assert FORMATS["csv"](document).startswith("table,env,classical")
    assert r"\begin{tabular}" in FORMATS["latex"](document)


MINE = """
def still(observation):
    return 0 * observation[:6]

def swing(observation):
    assert len(observation) == 3, "no pendulum"
    return [0.0]

def lost(observation):
    return swing(observation[:2])
"""


@pytest.mark.slow
def test_own_policies_play_where_they_fit_and_others_are_told(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(LINE_UPS, REACH, ("random",))
    found = suite([REACH, "Pendulum-v1"], policies=["mine.py:still", "mine.py:swing"], episodes=1, out="kept")
    assert [*found.tasks[REACH].comparisons["none"].counted] == ["random", "mine.py:still"]
    assert [*found.tasks["Pendulum-v1"].comparisons["none"].counted] == ["random", "mine.py:swing"]
    assert not found.problems
    for told in (found, read_study(tmp_path / "kept")):
        swing, still = told.notes
        assert swing == f"mine.py:swing does not play in {REACH}: AssertionError: no pendulum (mine.py:6)"
        assert still.startswith("mine.py:still does not play in Pendulum-v1: ")
        assert any(isinstance(part, Remark) and part.text == swing for part in told.document().parts)
    with pytest.raises(ConfigurationError, match=r"lost fits none of the tasks: in Pendulum-v1, .*\(mine.py:6\)"):
        suite(["Pendulum-v1"], policies="mine.py:lost")


@pytest.mark.slow
def test_an_interrupted_suite_resumes_and_is_the_same(finished, tmp_path):
    done = 0

    def interrupting(setting, total):
        nonlocal done
        done += 1
        assert total == 2 * 2 * 5
        if done == 9:
            raise KeyboardInterrupt

    cut = suite([REACH, MOVING], episodes=2, out=tmp_path / "cut", progress=interrupting)
    assert cut.interrupted
    assert read_study(tmp_path / "cut").interrupted
    again = suite([REACH, MOVING], episodes=2, out=tmp_path / "cut")
    assert not again.interrupted
    assert timeless(tmp_path / "cut").equals(timeless(finished[1]))


@pytest.mark.slow
def test_a_suite_that_grew_was_looked_at_before(folder):
    found = suite([REACH, MOVING], episodes=3, out=folder)
    words = "after an earlier look at 2 episodes, p is too small and intervals are too narrow"
    for told in (found, read_study(folder)):
        assert [one.looks for one in told.verdicts] == [[2], [2]]
        assert suite_headline(told.verdicts)[1].endswith(words)
    remarks = [part for part in found.tasks[REACH].document().parts if isinstance(part, Remark)]
    assert [one for one in remarks if one.text.endswith(f"false discovery rate 5 %); {words}.")]
    assert [one.text.endswith(f"; {words}.") for one in remarks if one.kind == "verdict"] == [True]


def test_a_task_that_fails_is_told_and_stops_no_other(tmp_path, monkeypatch):
    monkeypatch.setitem(LINE_UPS, MOVING, ("reach_ppo",))  # made for another task
    found = suite([MOVING, REACH], episodes=2, out=tmp_path)
    assert list(found.tasks) == [REACH]
    assert "agent reach_ppo" in found.failures[MOVING]
    assert any("agent reach_ppo" in problem for problem in read_study(tmp_path).problems)


def test_an_agent_whose_file_is_damaged_is_told(tmp_path, monkeypatch):
    (tmp_path / "mine.json").write_text("{")
    monkeypatch.setattr("armctl.study.line_up.agent_cards", lambda: {"mine_ppo": tmp_path / "mine.json"})
    found = suite([REACH], episodes=2, out=tmp_path / "suite")
    assert list(found.tasks) == list(found.failures) == [REACH]
    for told in (found, read_study(tmp_path / "suite")):
        assert any("mine_ppo was left out" in problem and "not an agent's card" in problem for problem in told.problems)


def test_only_agents_made_for_a_task_are_missed_in_it(monkeypatch):
    assert unusable_agents(REACH) == {}
    monkeypatch.setattr("armctl.agents.agent.sha256", lambda *_: "other")
    told = unusable_agents(REACH)
    assert "reach_ppo" in told
    assert "bridge_ppo" not in told
    assert "damaged" in told["reach_ppo"]


def test_unusable_arguments_say_so(folder):
    with pytest.raises(ConfigurationError, match="Did you mean"):
        suite(["ArmReach-v1"])
    with pytest.raises(ConfigurationError, match="workers"):
        suite([REACH], workers=0)
    with pytest.raises(ConfigurationError, match="needs environments"):
        suite([])
    with pytest.raises(ResultsError, match="seed: 0 there, 5 here"):
        suite([REACH], seed=5, out=folder)
    with pytest.raises(ResultsError, match=r"further results .*ArmReachMoving-v0/none.*: ask for these too"):
        suite([REACH], episodes=2, out=folder)
    with pytest.raises(ConfigurationError, match="cannot be the name"):
        task_name("../escape")


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"seed": "none"}, "cannot be read as results of a suite"),
        ({"kind": "tour"}, "cannot be read as results of a tour"),
        ({"kind": "sweep"}, "it has 2 tasks"),
        ({"seed": 7}, "is of another environment or seed"),
        ({"tasks": {REACH: {"levels": {"delay": ["much"]}}}}, "cannot be read as results of a suite"),
        ({"envs": [REACH] * 100_000}, "names a task or a level twice"),
    ],
)
def test_a_changed_record_is_refused(folder, values, says):
    change_record(folder, lambda record: record.update(values))
    with pytest.raises(ResultsError, match=says):
        read_study(folder)


def test_a_level_100_000_times_is_refused(folder):
    def change(record):
        levels = record["tasks"][REACH]["levels"]
        name = next(iter(levels))
        levels[name] = [levels[name][0]] + levels[name][1:] * 100_000

    change_record(folder, change)
    with pytest.raises(ResultsError, match="names a task or a level twice"):
        read_study(folder)


def test_a_task_of_another_name_is_not_found(folder):
    change_record(folder, lambda record: record.update(envs=["other/ArmReach-v0"]))
    assert read_study(folder).problems == [f"other/ArmReach-v0: {UNFINISHED}"]


def test_a_name_that_leads_elsewhere_is_refused(folder):
    def change(record):
        record["tasks"]["../../etc"] = record["tasks"].pop(REACH)
        record["envs"] = ["../../etc"]

    change_record(folder, change)
    with pytest.raises(ResultsError, match="cannot be the name of a task"):
        read_study(folder)


def test_a_task_that_was_killed_is_unfinished(folder):
    with contextlib.closing(sqlite3.connect(folder / STORE)) as file, file:
        file.execute("UPDATE cell SET facts = NULL WHERE name = 'ArmReachMoving-v0/none'")
    found = read_study(folder)
    assert list(found.tasks) == [REACH]
    assert found.problems == [f"{MOVING}: {UNFINISHED}"]


def test_without_success_a_task_is_no_part_of_the_comparison(tmp_path):
    found = suite(["Pendulum-v1"], episodes=2, out=tmp_path)
    assert [one.verdict for one in found.verdicts] == ["the environment does not say what a success is"]
    assert found.leagues == []
    assert read_study(tmp_path).verdicts[0].cells == {}
