"""Stages of a training: other options and weights from some share of its steps on."""

from contextlib import ExitStack

import numpy as np
import pytest

from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.rl.algorithms import bc, dagger, distil, ppo, sac
from armctl.rl.algorithms.ppo import PpoOptions
from armctl.rl.run.meter import Metered
from armctl.rl.run.training import Training
from armctl.training.learners import Recipe

STAGES = [
    {"after": 0.5, "training_options": {"tolerance": 0.1}, "reward_weights": {"goal": 0.5}},
    {"after": 0.75},
]
FEW = {"steps": 64, "worlds": 4, "validation_episodes": 2, "evaluation_episodes": 2, "evaluation_every": 10**6}
SHORT = {**FEW, "rollout_length": 4, "batch_size": 8}


def recipe(learner="ppo", options=SHORT, **changes):
    return Recipe(
        **{
            "name": learner, "learner": learner, "env": "armctl/ArmReach-v0", "env_options": {"max_episode_steps": 7},
            "training_options": {"tolerance": 0.2}, "reward_weights": {"goal": 0.2}, "curriculum": STAGES,
            "options": options, **changes,
        }
    )  # fmt: skip


@pytest.fixture
def stages(monkeypatch):
    """(tolerance, weight of the goal) in each control step of a training."""
    seen, step = [], Metered.step

    def noted(worlds, actions):
        seen.append((worlds.unwrapped.task.options.tolerance, worlds.unwrapped.reward_weights.get("goal", 1.0)))
        return step(worlds, actions)

    monkeypatch.setattr(Metered, "step", noted)
    return seen


def test_a_later_stage_replaces_what_held_before():
    found = [(chosen.training_options, chosen.reward_weights) for chosen in map(recipe().at_share, (0, 0.49, 0.5, 0.9))]
    first, second = ({"tolerance": 0.2}, {"goal": 0.2}), ({"tolerance": 0.1}, {"goal": 0.5})
    assert found == [first, first, second, ({}, {})]


@pytest.mark.one_case
@pytest.mark.parametrize("options", [{}, {"frames": 2}])
def test_ppo_changes_worlds(stages, options, unexported, tmp_path):
    card = ppo.train(recipe(options=SHORT | options), out=tmp_path / "run", seed=0, progress=False)
    assert stages == [(0.2, 0.2)] * 8 + [(0.1, 0.5)] * 4 + [(0.05, 1.0)] * 4
    assert (card.training_options, card.reward_weights) == ({"tolerance": 0.2}, {"goal": 0.2})
    assert [stage["after"] for stage in card.curriculum] == [0.5, 0.75]
    assert card.decisions == 64


def test_a_new_stage_begins_new_episodes(monkeypatch, unexported, tmp_path):
    shown, set_env = [], ppo.PPO.set_env

    def noted(model, worlds):
        set_env(model, worlds)
        shown.append(worlds)

    monkeypatch.setattr(ppo.PPO, "set_env", noted)
    collect, begun = ppo.PPO.collect_rollouts, []

    def collected(model, env, *args, **kwargs):
        begun.append((env, model._last_episode_starts.copy()))
        return collect(model, env, *args, **kwargs)

    monkeypatch.setattr(ppo.PPO, "collect_rollouts", collected)
    ppo.train(recipe(), out=tmp_path / "run", seed=0, progress=False)
    assert [env for env, _ in begun] == [begun[0][0]] * 2 + shown
    assert all(starts.all() for _, starts in begun[2:])


@pytest.mark.slow
def test_a_student_s_teacher_comes_along(stages, unexported, tmp_path):
    options = {**FEW, "length": 4, "epochs": 1, "hidden_units": 8, "memory_units": 8}
    chosen = recipe(
        "distil", options, reward_weights={}, curriculum=[{"after": 0.5}], teacher="reach_ik:prepared=false"
    )
    card = distil.train(chosen, out=tmp_path / "run", seed=0, progress=False)
    assert stages == [(0.2, 1.0)] * 8 + [(0.05, 1.0)] * 8
    assert card.teacher_queries == 64


def test_a_resumed_training_is_in_its_stage(unexported, tmp_path):
    out = tmp_path / "run"
    ppo.train(recipe(options=SHORT | {"steps": 32}), out=out, seed=0, progress=False)
    with ExitStack() as opened:
        training = Training(recipe(), PpoOptions(**SHORT), out, 0, True)
        opened.callback(training.envs.close)
        assert training.envs.unwrapped.task.options.tolerance == 0.1
        assert not training.enter_stage(47)
        assert training.enter_stage(48)
        assert training.envs.unwrapped.task.options.tolerance == 0.05
        observations, _ = training.envs.reset(seed=0)
        assert np.isfinite(observations).all()


@pytest.mark.parametrize("module", [bc, dagger, sac])
def test_others_have_one_stage(module, tmp_path):
    name = module.__name__.rpartition(".")[2]
    chosen = recipe(name, {}, teacher="reach_ik", reward_weights={}, curriculum=[{"after": 0.5}])
    with pytest.raises(ConfigurationError, match=f"{name} takes no curriculum"):
        module.train(chosen, out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("stage", "says"),
    [
        ({"training_options": {"robot": "ur10"}}, "belongs in env_options"),
        ({"training_options": {"tolerence": 0.1}}, "Did you mean 'tolerance'"),
        ({"reward_weights": {"gaol": 1.0}}, "Did you mean 'goal'"),
    ],
)
def test_a_mistake_in_a_later_stage_is_told_at_once(stage, says, tmp_path):
    with pytest.raises(ConfigurationError, match=says):
        ppo.train(recipe(curriculum=[{"after": 0.9, **stage}]), out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()


def test_a_privileged_critic_s_state_keeps_its_shape(tmp_path):
    people = [{"after": 0.5, "training_options": {"walkers": 3}}]
    chosen = recipe(
        options=SHORT | {"privileged_critic": True}, env="armctl/BridgeCrossMoving-v0", reward_weights={},
        training_options={"walkers": 1}, curriculum=people,
    )  # fmt: skip
    with pytest.raises(ConfigurationError, match="privileged critic"):
        ppo.train(chosen, out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()


def test_a_teacher_who_does_not_fit_a_later_stage_is_told_at_once(tmp_path):
    planar = {"observation": "ranges", "dynamics": "kinematic"}
    chosen = recipe(
        "distil", FEW, env="armctl/BridgeCrossMoving-v0", env_options={}, teacher="bridge_moving_state_ppo",
        training_options=planar, reward_weights={},
        curriculum=[{"after": 0.5, "training_options": planar | {"walkers": 1}}],
    )  # fmt: skip
    with pytest.raises(AgentFileError, match="observation"):
        distil.train(chosen, out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()
