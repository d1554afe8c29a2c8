"""What a policy, a user or a disk does wrong in a comparison: it is told, and spoils nothing that is finished."""

import io
import json
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.report.terminal import tables
from armctl.rollout import evaluate
from armctl.study import compare

from .. import command_line
from ..holding_still import HoldsStill
from ..printed import text_of
from ..stores import read_cell


class Fragile(HoldsStill):
    """Holds still, and misbehaves after some decisions."""

    def __init__(self, decisions, misbehave):
        self.decisions, self.misbehave = decisions, misbehave

    def act(self, observations):
        self.decisions -= 1
        return observations[:, 3:9] if self.decisions >= 0 else self.misbehave(observations)


def fail(observations):
    raise RuntimeError("out of ideas")


def interrupt(observations):
    raise KeyboardInterrupt


def failing(env):
    return Fragile(250, fail)


def not_a_number(env):
    return Fragile(250, lambda observations: np.full((len(observations), 6), np.nan))


def interrupted(env):
    return Fragile(250, interrupt)


@pytest.mark.one_case
@pytest.mark.parametrize(("policy", "says"), [("failing", "out of ideas"), ("not_a_number", "not finite")])
def test_a_policy_that_fails_plays_on_and_spoils_nothing_that_is_finished(tmp_path, policy, says):
    name = f"{__name__}:{policy}"
    comparison = compare([name, "random"], episodes=4, out=tmp_path)
    assert says in comparison.failures[name]
    assert "in 2 of 4 episodes" in comparison.failures[name]
    assert "episode 2" in comparison.failures[name]
    outcomes = pd.read_csv(tmp_path / "episodes.csv").groupby("policy").outcome
    assert outcomes.agg(list)[name] == ["timeout", "timeout", "error", "error"]
    assert outcomes.size()["random"] == 4
    assert evaluate(name, episodes=4).outcome.tolist() == ["timeout", "timeout", "error", "error"]


def test_an_interrupt_keeps_what_is_finished(tmp_path):
    name = f"{__name__}:interrupted"
    comparison = compare(["random", name], episodes=3, out=tmp_path)
    assert comparison.interrupted
    assert pd.read_csv(tmp_path / "episodes.csv").groupby("policy").size().to_dict() == {"random": 3, name: 2}
    assert json.loads((tmp_path / "summary.json").read_text())["interrupted"]
    assert "Interrupted" in text_of(comparison)


def test_results_are_not_overwritten_unasked(tmp_path):
    compare(["random"], episodes=1, out=tmp_path)
    before = (tmp_path / "episodes.csv").read_text()
    with pytest.raises(ResultsError, match="--overwrite"):
        compare(["random"], episodes=1, seed=1, out=tmp_path)
    assert (tmp_path / "episodes.csv").read_text() == before
    compare(["random"], episodes=2, out=tmp_path, overwrite=True)
    assert len(pd.read_csv(tmp_path / "episodes.csv")) == 2


def test_results_where_no_folder_can_be(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ResultsError, match="cannot be written"):
        compare(["random"], episodes=1, out=tmp_path / "file" / "results")


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_full_disk_is_reported_and_nothing_that_was_written_is_lost(tmp_path, workers):
    short = ["--worlds", "10", "--set", "max_episode_steps=5"]
    command = ["compare", "random", "--episodes", "60", *short, "--out", "out"]
    run = command_line.armctl if workers == "1" else command_line.program
    full = run(*command, "--workers", workers, cwd=tmp_path, check=False, disk=100_000)
    assert full.returncode == 1
    assert "could not be written any further" in full.stdout
    assert "has the episodes" not in full.stdout
    assert "Traceback" not in full.stdout + full.stderr
    assert not (tmp_path / "out" / "summary.json").exists()
    assert 0 < len(read_cell(tmp_path / "out").episodes) < 60
    again = command_line.armctl(*command, cwd=tmp_path)
    assert "episodes were finished by an earlier run" in again.stdout
    assert len(pd.read_csv(tmp_path / "out" / "episodes.csv")) == 60


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"policies": []}, "at least one policy"),
        ({"policies": ["random", "random"]}, "compared only once"),
        ({"policies": ["rndom"]}, "Did you mean 'random'"),
        ({"env": "armctl/ArmReech-v0"}, "ArmReach-v0"),
        ({"env": "CartPole-v1", "policies": ["reach_ik"]}, "cannot play this task"),
        ({"episodes": 0}, "at least 1"),
        ({"episodes": 10**30}, "at most 10,000,000"),
        ({"episodes": 10**9, "worlds": 10**9}, "at most"),
        ({"workers": 10**6}, "at most 1,000"),
        ({"worlds": 0}, "at least 1"),
        ({"workers": 0}, "at least 1"),
        ({"seed": -1}, "seed is a whole number"),
        ({"seed": 2**63}, "are for training"),
        ({"policies": ["json:JSONDecoder"]}, "a class without act"),
        ({"policies": ["json:__name__"]}, "not a policy"),
        ({"env_options": {"num_envs": 3}}, "num_envs"),
        ({"env_options": {"tolerance": "wide"}}, "tolerance"),
        ({"env_options": {"target_box": 5}}, "target_box"),
        ({"env_options": {"robot": 5}}, "robot"),
        ({"env_options": {"observation": "all"}}, "observation"),
        ({"env_options": {"robot": "ur7"}}, "Did you mean"),
    ],
)
def test_bad_arguments_are_refused_before_anything_runs(tmp_path, arguments, says):
    with pytest.raises(ConfigurationError, match=says):
        compare(**{"policies": ["random"], "episodes": 1, "out": tmp_path / "results"} | arguments)
    assert not (tmp_path / "results").exists()


def odd_reset(env):
    policy = armctl.make_policy("random", env)
    policy.reset = lambda ids: 1 / 0
    return policy


def words(env):
    policy = armctl.make_policy("random", env)
    policy.act = lambda observations: [["up"] * 6] * len(observations)
    return policy


@pytest.mark.parametrize(("policy", "says"), [(odd_reset, "ZeroDivisionError"), (words, "array of numbers")])
def test_whatever_a_policy_does_wrong_is_its_own_failure(policy, says):
    assert says in compare([policy], episodes=1).failures[policy.__name__]


def test_policies_of_an_unknown_environment_are_not_guessed():
    with pytest.raises(ConfigurationError, match="BridgeCross-v0"):
        compare(env="armctl/BridgeCros-v0")


def test_failures_of_solvers_are_reported():
    def sometimes_at_a_loss(env):
        policy: Any = Fragile(10**6, fail)
        policy.failures = np.zeros(3, dtype=int)
        policy.reset = lambda ids: policy.failures.__iadd__(1)
        return policy

    comparison = compare([sometimes_at_a_loss, "reach_ik"], episodes=3, worlds=3)
    assert [policy.solver_failures for policy in comparison.policies] == [3, 0]
    console = Console(file=(out := io.StringIO()), width=100)
    console.print(tables(comparison))
    assert " ".join(out.getvalue().split()).count("solver failures: 3") == 1
