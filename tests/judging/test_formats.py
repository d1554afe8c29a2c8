"""Files of each kind, made by the libraries themselves where they are installed, or else as they are documented."""

import importlib.util
import json
import sys
from dataclasses import replace

import gymnasium
import numpy as np
import pandas as pd
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.judging import judge

from .written import WINS, evaluations, judged, lerobot, robo_evals, rows_of, table, vla_eval

VERDICT = "new is better than old: success +35.0 points"


def of(judgement):
    return judgement.overall.verdict.result


def test_a_table_in_every_plain_form(tmp_path):
    lines = rows_of(WINS)
    expected = judged(tmp_path, lines).overall
    assert expected.verdict.result.startswith(VERDICT)
    records = [dict(zip(("policy", "episode", "success"), line.split(","), strict=True)) for line in lines[1:]]
    frame = pd.DataFrame(records)
    others = [
        table(tmp_path, [line.replace(",", ";") for line in lines], "semicolons.csv"),
        table(tmp_path, [line.replace(",", "\t") for line in lines], "tabs.tsv"),
        table(tmp_path, map(json.dumps, records), "lines.jsonl"),
        table(tmp_path, [json.dumps(records)], "list.json"),
        table(tmp_path, [json.dumps({"episodes": records})], "object.json"),
        table(tmp_path, [json.dumps(frame.to_dict(orient="list"))], "columns.json"),
        table(tmp_path, lines, "utf16.csv", encoding="utf-16"),
        table(tmp_path, lines, "bom.csv", encoding="utf-8-sig"),
        table(tmp_path, [lines[0], *lines[:0:-1]], "upside_down.csv"),
    ]
    if importlib.util.find_spec("pyarrow"):
        frame.assign(success=frame.success == "yes", times=pd.Series([[1.0]] * 80, dtype=object)).to_parquet(
            tmp_path / "table.parquet"
        )
        others.append(tmp_path / "table.parquet")
    for file in [*others, frame, frame.assign(success=frame.success == "yes", episode=frame.episode.astype(float))]:
        assert str(judge(file).overall.differences) == str(expected.differences)


def test_files_of_one_policy_each_are_called_by_their_names(tmp_path):
    for policy, wins in zip(("new", "old"), WINS, strict=True):
        table(tmp_path, ["ok", *("1" if k in wins else "0" for k in range(40))], f"{policy}.csv")
    judgement = judge([tmp_path / "old.csv", tmp_path / "new.csv"])
    assert [policy.policy for policy in judgement.overall.policies] == ["old", "new"]
    assert not judgement.overall.facts.paired
    assert judge(tmp_path).conclusions[0].outcome == "better"


def test_folders_name_policies_whose_files_have_all_the_same_name(tmp_path):
    for policy, wins in zip(("new", "old"), WINS, strict=True):
        lerobot(tmp_path / policy / "eval", wins, tasks=1)
    judgement = judge(tmp_path)
    assert {policy.policy for policy in judgement.overall.policies} == {"new/eval", "old/eval"}


@pytest.mark.parametrize("name", ["eval_info.json", "before.json"])
def test_lerobot(tmp_path, name):
    files = [
        lerobot(tmp_path / policy, wins, tasks=1) / name for policy, wins in zip(("new", "old"), WINS, strict=True)
    ]
    judgement = judge(files, return_bounds=(0.0, 2.0))
    assert judgement.overall.facts.paired
    assert judgement.overall.differences[0].success_difference.value == pytest.approx(0.35)
    assert all(policy.kind == "learned" for policy in judgement.overall.policies)
    expected = any("--unpaired" in note for note in judgement.overall.notes)
    assert expected == (name == "eval_info.json")


def test_lerobot_with_several_tasks(tmp_path):
    for policy, wins in zip(("new", "old"), WINS, strict=True):
        lerobot(tmp_path / policy, wins)
    judgement = judge([tmp_path / "new" / "eval_info.json", tmp_path / "old" / "eval_info.json"])
    assert [*judgement.cells] == ["libero_10 0", "libero_10 1"]
    assert judgement.overall.policies[0].episodes == 80


def test_vla_eval_leaves_out_what_its_harness_lost(tmp_path):
    files = [vla_eval(tmp_path / f"{name}.json", wins, lost={3} if name == "new" else ())
             for name, wins in zip(("new", "old"), WINS, strict=True)]  # fmt: skip
    judgement = judge(files, max_steps=500)
    assert judgement.overall.differences[0].episodes == 39
    assert any("1 episodes of pick that the harness lost" in note for note in judgement.overall.notes)
    assert any("are left out: 1 of old (0 of them" in note for note in judgement.overall.notes)
    assert judgement.overall.policies[0].restricted_steps is not None


def test_robo_evals(tmp_path):
    files = [robo_evals(tmp_path / f"{i}.json", name, wins)
             for i, (name, wins) in enumerate(zip(("new", "old"), WINS, strict=True))]  # fmt: skip
    judgement = judge(files)
    assert of(judgement).startswith(VERDICT)
    assert judgement.overall.facts.time_limit == 300


@pytest.mark.slow
def test_stable_baselines3(tmp_path):
    """Its `EvalCallback` and `Monitor`, as the library writes them."""
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.callbacks import EvalCallback
    from stable_baselines3.common.monitor import Monitor

    for name in ("a2c", "ppo"):
        env = Monitor(gymnasium.make("CartPole-v1"), str(tmp_path / f"{name}_train"))
        callback = EvalCallback(
            Monitor(gymnasium.make("CartPole-v1")), log_path=str(tmp_path / name), eval_freq=64, n_eval_episodes=12,
            verbose=0,
        )  # fmt: skip
        model = (sb3.A2C if name == "a2c" else sb3.PPO)("MlpPolicy", env, n_steps=64, seed=0)
        model.learn(128, callback)
    written = np.load(tmp_path / "ppo" / "evaluations.npz")
    judgement = judge([tmp_path / "a2c", tmp_path / "ppo"], return_bounds=(0.0, 500.0), max_steps=500)
    ppo = next(policy for policy in judgement.overall.policies if policy.policy == "ppo")
    assert ppo.episode_return.value == pytest.approx(written["results"][-1].mean())
    assert ppo.length.value == pytest.approx(written["ep_lengths"][-1].mean())
    assert (ppo.training.steps, ppo.side) == (int(written["timesteps"][-1]), "learned")
    assert any("the last of 2 evaluations" in note for note in judgement.overall.notes)
    monitors = judge([tmp_path / "a2c_train.monitor.csv", tmp_path / "ppo_train.monitor.csv"])
    assert {policy.policy for policy in monitors.overall.policies} == {"a2c_train", "ppo_train"}
    assert [*monitors.cells] == ["CartPole-v1"]


@pytest.mark.slow
def test_logs_that_rl_zoo_itself_writes(tmp_path, monkeypatch):
    pytest.importorskip("rl_zoo3")
    from rl_zoo3.train import train

    monkeypatch.chdir(tmp_path)
    for algorithm, seed in (("a2c", 1), ("ppo", 1), ("ppo", 2)):
        options = ("--eval-freq", "100", "--eval-episodes", "5", "--n-eval-envs", "1", "-f", "logs", "--seed", seed)
        command = ["train", "--algo", algorithm, "--env", "CartPole-v1", "-n", "300", *map(str, options)]
        monkeypatch.setattr(sys, "argv", command)
        train()
    comparison = judge(tmp_path / "logs").overall
    assert (comparison.env, comparison.names) == ("CartPole-v1", ["a2c", "ppo[*]"])
    written = np.load(tmp_path / "logs" / "a2c" / "CartPole-v1_1" / "evaluations.npz")
    a2c = comparison.policies[0]
    assert a2c.episode_return.value == pytest.approx(written["results"][-1].mean())
    assert (a2c.episodes, a2c.training.steps) == (5, written["timesteps"][-1])


def test_rl_zoo_has_trainings_of_one_learner(tmp_path):
    for algo, mean in (("ppo", 0.0), ("sac", 5.0)):
        for run in (1, 2, 3, 10):
            evaluations(tmp_path / "logs" / algo / f"Pendulum-v1_{run}" / "evaluations.npz", mean, seed=run)
    comparison = judge(tmp_path / "logs", return_bounds=(-20.0, 20.0)).overall
    assert comparison.env == "Pendulum-v1"
    assert comparison.names == ["ppo[*]", "sac[*]"]
    assert comparison.facts.groups["sac[*]"] == ["sac[1]", "sac[2]", "sac[3]", "sac[10]"]


@pytest.mark.slow
def test_the_figures_are_those_of_compare_on_the_same_episodes(tmp_path):
    played = armctl.compare(["random", "reach_ik"], episodes=20, out=tmp_path / "out", worlds=20)
    facts = played.facts
    from_csv = judge(tmp_path / "out" / "episodes.csv", max_steps=facts.time_limit, return_bounds=facts.return_bounds)
    from_folder = judge(tmp_path / "out")
    assert [*from_csv.overall.differences] == [*from_folder.overall.differences] == [*played.differences]
    assert str(from_folder.overall.verdict) == str(played.verdict)
    assert from_csv.overall.verdict.result == played.verdict.result
    for mine, theirs in zip(from_csv.overall.policies, played.policies, strict=True):
        for figure in ("success", "episode_return", "restricted_steps", "length", "worst_decile"):
            assert getattr(mine, figure) == getattr(theirs, figure), figure
    with pytest.raises(ConfigurationError, match="no policy in these results 'reach_i'"):
        judge(tmp_path / "out", baseline="reach_i")


@pytest.mark.slow
def test_results_of_armctl_and_of_others_are_judged_together(tmp_path):
    played = armctl.compare(["reach_ik"], episodes=20, out=tmp_path / "out", worlds=20)
    rows = [f"mine,0,{k},{k % 2}" for k in range(20)]
    table(tmp_path, ["policy,seed,episode,success", *rows])
    judgement = judge([tmp_path / "out", tmp_path / "trials.csv"])
    assert judgement.overall is None  # they name different tasks
    task = [f"{row},{played.env}" for row in rows]
    table(tmp_path, ["policy,seed,episode,success,task", *task])
    comparison = judge([tmp_path / "out", tmp_path / "trials.csv"]).overall
    assert comparison.facts.paired
    assert comparison.differences[0].episodes == 20


@pytest.mark.slow
def test_conditions_that_are_levels_make_a_sweep(tmp_path):
    played = armctl.sweep(
        ["random", "reach_ik"], disturbances={"payload": [2.0, 4.0]}, episodes=20, out=tmp_path / "out", worlds=20
    )
    facts = played.undisturbed.facts
    known = {"max_steps": facts.time_limit, "return_bounds": facts.return_bounds}
    judgement = judge(tmp_path / "out" / "episodes.csv", **known)
    mine, theirs = (
        [part.rows for part in parts if getattr(part, "key", "") == "points"]
        for parts in (judgement.study, played.document().parts)
    )
    assert mine == theirs
    own = judge(tmp_path / "out").document()
    assert str(own) == str(played.document())


@pytest.mark.slow
def test_episodes_of_another_environment_are_not_compared(tmp_path):
    armctl.compare(["reach_ik"], episodes=3, out=tmp_path / "a", worlds=3)
    armctl.compare(["random"], episodes=3, out=tmp_path / "b", worlds=3, env_options={"tolerance": 0.6})
    with pytest.raises(ConfigurationError, match=r"options of .*ArmReach-v0: tolerance=0.6 and default"):
        judge([tmp_path / "a", tmp_path / "b"])


def own_part(monkeypatch, tmp_path, **changes):
    """Read a folder of armctl's with other facts."""
    from armctl.judging.formats import own
    from armctl.study.results import read_study

    study = read_study(tmp_path / "a")
    for cell in study.cells.values():
        cell.facts = replace(cell.facts, **changes)
    monkeypatch.setattr(own, "read_study", lambda folder: study)
    return own.read(tmp_path / "b")


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"versions": {"armctl-suite": "0.0.1", "mujoco": "3.0"}},
        {"real_time": {"latency": "measured", "slow_down": 1.0}},
        {"time_limit": 1000},
        {"return_bounds": (-1000.0, 99.0)},
        {"env_options": {"goal": "far"}},
    ],
)
def test_folders_of_armctl_differ_in_what_defines_an_episode(tmp_path, monkeypatch, changes):
    from armctl.judging.formats import own
    from armctl.judging.trials import trials_of

    armctl.compare(["reach_ik"], episodes=3, out=tmp_path / "a", worlds=3)
    parts = own.read(tmp_path / "a")
    same = own_part(monkeypatch, tmp_path)
    assert len(trials_of([*parts, *same], {}, {}).trials) == 6
    with pytest.raises(ConfigurationError, match=r"/b and .*/a differ in the "):
        trials_of([*parts, *own_part(monkeypatch, tmp_path, **changes)], {}, {})


def test_each_task_has_its_time_limit_and_all_have_the_widest_returns():
    from armctl.judging.cells import Terms, comparisons_of
    from armctl.judging.rows import Rows
    from armctl.judging.trials import trials_of

    limits = {"a": (100, (-100.0, 9.0)), "b": (300, (-10.0, 99.0)), "c": (200, (0.0, 1.0))}
    parts = [
        Rows(source=f"{policy} {task}", headings=["episode", "success", "return", "steps"], places=range(20),
             values=[[k, k % 2, 0.5, 50] for k in range(20)], constants={"task": task, "policy": policy},
             is_known_format=True, time_limit=limit, return_bounds=bounds)
        for task, (limit, bounds) in limits.items() for policy in ("new", "old")
    ]  # fmt: skip
    facts = {cell.name: comparison.facts for cell, comparison in comparisons_of(trials_of(parts, {}, {}), Terms())}
    assert {name: about.time_limit for name, about in facts.items()} == {"a": 100, "b": 300, "c": 200, "all": 300}
    assert facts["all"].return_bounds == (-100.0, 99.0)


def test_time_limits_of_one_task_are_equal(tmp_path):
    new, old = (robo_evals(tmp_path / f"{name}.json", name, set(range(n))) for name, n in (("new", 30), ("old", 9)))
    assert judge([new, old]).overall.facts.time_limit == 300
    old.write_text(old.read_text().replace('"max_steps": 300', '"max_steps": 500'))
    with pytest.raises(ConfigurationError, match="differ in the time limit: 500 steps and 300 steps"):
        judge([new, old])
