import importlib
import json
import shutil

import pandas as pd
import pytest

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.files import sealed, unsealed
from armctl.episodes.record import TIME_COLUMNS
from armctl.report.formats import FORMATS
from armctl.report.suite_page import headline as suite_headline
from armctl.study.curves import read_sweep
from armctl.study.suite import FULL, QUICK, Size, folder_of, line_up, plan_task, suite, unusable_agents
from armctl.study.suite_results import read_suite
from armctl.verdict.tables import Remark, Table

module = importlib.import_module("armctl.study.suite")
REACH, MOVING = "armctl/ArmReach-v0", "armctl/ArmReachMoving-v0"
SMALL = Size(2, ("delay",), (0.25,))
LINE_UPS = {REACH: ("reach_ik", "reach_ppo", "reach_bc"), MOVING: ("reach_ik", "moving_ppo")}


@pytest.fixture(autouse=True, scope="module")
def small():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "FULL", SMALL)
        patch.setattr(module, "line_up", lambda env: LINE_UPS.get(env) or line_up(env))
        yield


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    return suite([REACH, MOVING], out=folder), folder


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished[1], tmp_path / "suite")


def timeless(folder):
    return {
        str(path.parent.relative_to(folder)): pd.read_csv(path).drop(columns=list(TIME_COLUMNS)).to_csv()
        for path in folder.glob("*/*/episodes.csv")
    }


def change(path, **values):
    path.write_text(sealed(unsealed(path.read_text()) | values))


@pytest.mark.parametrize("size", [FULL, QUICK])
def test_every_task_of_armctl_has_both_kinds_and_main_disturbances(size):
    for env, other in (("armctl/ArmReachObstacles-v0", "noise_on_state"), ("armctl/BridgeCross-v0", "noise")):
        plan = plan_task(env, size)
        assert set(plan.disturbances) == set(size.disturbances) - {other}
        assert {len(levels) for levels in plan.disturbances.values()} == {len(size.levels)}
    learned = {"bridge_distil", "bridge_ppo", "bridge_robust_ppo", "bridge_state_ppo"}
    assert set(plan.policies) == {"bridge_ompl", "bridge_mpc"} | learned
    assert plan.runs == 6 * (1 + len(plan.disturbances) * len(size.levels))


def test_random_actions_play_only_where_there_is_nothing_else():
    assert "random" not in line_up(REACH)
    assert line_up("Pendulum-v1") == ("random",)


def test_the_result_is_that_of_sweeps(finished):
    found, folder = finished
    assert set(timeless(folder)) == {f"{task}/{at}" for task in ("ArmReach-v0", "ArmReachMoving-v0")
                                     for at in ("none", "delay-1.0")}  # fmt: skip
    alone = armctl.sweep(LINE_UPS[MOVING], MOVING, disturbances={"delay": [1]}, episodes=2)
    pd.testing.assert_frame_equal(
        *(swept.points.drop(columns=["p"]) for swept in (alone, found.tasks[MOVING])), check_dtype=False
    )
    assert found.problems == []


def test_what_is_read_back_is_what_was_found(finished):
    found, folder = finished
    again = read_suite(folder)
    assert [one.sentence for one in again.answers] == [one.sentence for one in found.answers]
    assert [one.heads for one in again.answers] == [one.heads for one in found.answers]
    for one in again.answers:
        policies = {policy.policy: policy.restricted_steps.value for policy in one.policies}
        expert, agent = (policies[choice.policy] for choice in (one.classical, one.learned))
        assert one.undisturbed.steps.value == pytest.approx(expert - agent)
    assert again.leagues == found.leagues
    assert repr(again) == repr(found) == "<Suite of armctl/ArmReach-v0, armctl/ArmReachMoving-v0, seed 0>"


def test_tables_in_all_formats(finished):
    document = finished[0].document()
    tasks = next(part for part in document.parts if isinstance(part, Table))
    assert [row[0].text for row in tasks.rows] == [REACH, MOVING]
    assert "No verdict from 2 episodes: reach_ik against" in FORMATS["markdown"](document).replace("\\", "")
    assert {one["env"] for one in json.loads(FORMATS["json"](document))["tasks"]} == {REACH, MOVING}
    assert FORMATS["csv"](document).startswith("table,env,classical")
    assert r"\begin{tabular}" in FORMATS["latex"](document)


def test_an_interrupted_suite_resumes_and_is_the_same(finished, tmp_path):
    done = 0

    def interrupting(setting, total):
        nonlocal done
        done += 1
        assert total == 2 * 2 * 5
        if done == 9:
            raise KeyboardInterrupt

    cut = suite([REACH, MOVING], out=tmp_path / "cut", progress=interrupting)
    assert cut.interrupted
    assert read_suite(tmp_path / "cut").interrupted
    again = suite([REACH, MOVING], out=tmp_path / "cut")
    assert not again.interrupted
    assert timeless(tmp_path / "cut") == timeless(finished[1])


def test_a_suite_that_grew_was_looked_at_before(folder):
    found = suite([REACH, MOVING], episodes=3, out=folder)
    words = "after an earlier look at 2 episodes, p is too small and intervals are too narrow"
    for told in (found, read_suite(folder)):
        assert [one.looks for one in told.answers] == [[2], [2]]
        assert suite_headline(told.answers).endswith(f"; {words}")
    remarks = [part for part in found.tasks[REACH].document().parts if isinstance(part, Remark)]
    assert [one for one in remarks if one.text.endswith(f"false discovery rate 5 %); {words}.")]
    assert [one.text.endswith(f"; {words}.") for one in remarks if one.kind == "verdict"] == [True]
    assert read_sweep(folder / "ArmReach-v0").attrs["looks"] == [2]


def test_a_task_that_fails_is_told_and_stops_no_other(tmp_path, monkeypatch):
    monkeypatch.setitem(LINE_UPS, MOVING, ("reach_ppo",))  # made for another task
    found = suite([MOVING, REACH], out=tmp_path)
    assert list(found.tasks) == [REACH]
    assert "agent reach_ppo" in found.failures[MOVING]
    assert any("agent reach_ppo" in problem for problem in read_suite(tmp_path).problems)


def test_an_agent_whose_file_is_damaged_is_told(tmp_path, monkeypatch):
    (tmp_path / "mine.json").write_text("{")
    monkeypatch.setattr(module, "agent_cards", lambda: {"mine_ppo": tmp_path / "mine.json"})
    found = suite([REACH], out=tmp_path / "suite")
    assert list(found.tasks) == list(found.failures) == [REACH]
    for told in (found, read_suite(tmp_path / "suite")):
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
    with pytest.raises(ResultsError, match="another seed \\(0 there, 5 here\\)"):
        suite([REACH], seed=5, out=folder)
    with pytest.raises(ResultsError, match=f"further tasks \\({MOVING}\\): name these too"):
        suite([REACH], out=folder)
    with pytest.raises(ConfigurationError, match="cannot be the name"):
        folder_of("../escape")


def test_nothing_is_played_through_a_link(folder, tmp_path):
    (folder / "ArmReach-v0").rename(tmp_path / "elsewhere")
    (folder / "ArmReach-v0").symlink_to(tmp_path / "elsewhere")
    found = suite([REACH, MOVING], episodes=3, out=folder)
    assert "symbolic link" in found.failures[REACH]


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"seed": "none"}, "cannot be read as results of a suite"),
        ({"envs": ["../../etc"]}, "cannot be the name of a task's folder"),
        ({"seed": 7}, "holds a sweep of armctl/ArmReach-v0, seed 0, not one of armctl/ArmReach-v0, seed 7"),
        ({"envs": ["other/ArmReach-v0", "ArmReach-v0"]}, "holds a sweep of armctl/ArmReach-v0"),
    ],
)
def test_a_changed_suite_is_refused(folder, values, says):
    change(folder / "suite.json", **values)
    with pytest.raises(ResultsError, match=says):
        read_suite(folder)


@pytest.mark.parametrize("spoil", ["suite.json", "ArmReach-v0/sweep.json", "ArmReach-v0/none/results.sqlite"])
def test_a_damaged_file_is_named(folder, spoil):
    content = (folder / spoil).read_bytes()
    (folder / spoil).write_bytes(content.replace(b"0", b"1", 1) if spoil.endswith("json") else content[:-9_000])
    with pytest.raises(ResultsError, match=spoil.rpartition("/")[2]):
        read_suite(folder)


def test_a_folder_of_another_place_is_not_read(folder):
    change(folder / "ArmReach-v0" / "sweep.json", disturbances={"../../secret": [0.0, 1.0]})
    with pytest.raises(ResultsError, match="cannot be the name of a comparison"):
        read_suite(folder)


def test_an_unfinished_task_is_told(folder):
    (folder / "ArmReachMoving-v0" / "sweep.json").unlink()
    found = read_suite(folder)
    assert list(found.tasks) == [REACH]
    assert found.problems == [f"{MOVING}: its sweep is unfinished: the same command resumes it"]


def test_without_success_a_task_is_no_part_of_the_comparison(tmp_path):
    found = suite(["Pendulum-v1"], episodes=2, out=tmp_path)
    assert [one.sentence for one in found.answers] == ["Pendulum-v1: the environment does not say what a success is."]
    assert found.leagues == []
    assert read_suite(tmp_path).answers[0].cells == {}
