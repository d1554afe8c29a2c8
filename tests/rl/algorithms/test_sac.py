import shutil

import numpy as np
import pandas as pd
import pytest
from stable_baselines3 import SAC
from stable_baselines3.common.save_util import load_from_pkl

from armctl.agents import load_agent
from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.rl.algorithms.hindsight import GoalVectorEnv
from armctl.rl.algorithms.sac import SacOptions, _make_vec_env, _noise, train
from armctl.rl.algorithms.sb3_training import REPLAY
from armctl.rl.networks.frames import History
from armctl.rl.networks.view import view_of
from armctl.rl.run.training import Training
from armctl.rollout import evaluate
from armctl.tasks import ReachTask
from armctl.training.learners import load_recipe

SMALL = {
    "steps": 800,
    "worlds": 8,
    "gradient_steps": 1,
    "batch_size": 64,
    "buffer_size": 4000,
    "random_steps": 400,
    "features": "invariant",
    "frames": 2,
    "evaluation_every": 400,
    "validation_episodes": 4,
    "evaluation_episodes": 4,
}


def small(**options):
    return load_recipe("reach_sac").changed(options={**SMALL, **options}, env_options={"max_episode_steps": 30})


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "small"
    return out, train(small(), out=out, seed=1, progress=False)


def checkpoint(out, steps):
    env = TaskVectorEnv(8, task=ReachTask, autoreset_mode="same_step")
    view = view_of(env)
    goals = GoalVectorEnv(History(view, env.single_observation_space, 2), env, view)
    return SAC.load(out / "checkpoints" / f"{steps}.zip", goals, "cpu")


@pytest.mark.slow
def test_training_leaves_a_runnable_agent(trained):
    out, card = trained
    assert (card.recipe, card.learner, card.training_steps) == ("reach_sac", "sac", 800)
    assert pd.read_csv(out / "curve.csv").steps.tolist() == [0, 400, 800]
    assert len(evaluate(str(out / "agent.json"), episodes=3)) == 3


@pytest.mark.slow
def test_exported_graph_is_the_squashed_mean_of_plain_observations(trained):
    out, card = trained
    worlds = TaskVectorEnv(50, task=ReachTask)
    observations, _ = worlds.reset(seed=0)
    model = checkpoint(out, card.best_after)
    raw = model.predict({"observation": np.stack([np.asarray(observations)] * 2, axis=1)}, deterministic=True)[0]
    assert np.ptp(raw) > 0.01
    expected = observations[:, 3:9] + 0.5 * raw
    np.testing.assert_allclose(load_agent(out / "agent.json", worlds).act(observations), expected, atol=1e-5)


@pytest.mark.slow
def test_a_resumed_training_goes_on_with_its_replay_buffer(trained, tmp_path, unexported):
    out = shutil.copytree(trained[0], tmp_path / "small")
    before = load_from_pkl(out / "checkpoints" / REPLAY)
    card = train(small(steps=1200), out=out, seed=1, resume=True, progress=False)
    assert card.training_steps == 1200
    after = load_from_pkl(out / "checkpoints" / REPLAY)
    assert (before.pos, after.pos) == (100, 150)
    np.testing.assert_array_equal(after.rewards[:100], before.rewards[:100])
    assert pd.read_csv(out / "curve.csv").steps.tolist() == [0, 400, 800, 1200]


@pytest.mark.slow
def test_without_its_replay_buffer_a_training_does_not_go_on(trained, tmp_path):
    out = shutil.copytree(trained[0], tmp_path / "small")
    (out / "checkpoints" / REPLAY).unlink()
    with pytest.raises(ConfigurationError, match=REPLAY):
        train(small(steps=1200), out=out, seed=1, resume=True)


@pytest.mark.slow
def test_training_is_reproducible(trained, tmp_path):
    train(small(), out=tmp_path / "small", seed=1, progress=False)
    worlds = TaskVectorEnv(20, task=ReachTask)
    observations, _ = worlds.reset(seed=1)
    actions = [load_agent(f / "agent.json", worlds).act(observations) for f in (trained[0], tmp_path / "small")]
    np.testing.assert_allclose(actions[0], actions[1], atol=1e-4)


@pytest.mark.parametrize(
    "changes",
    [
        {"shaping": "distance"},
        {"reward_weights": {"step": 0.5}},
        {"env_options": {"reward": {}}},
        {"env_options": {"observation": "full"}},
    ],
)
def test_hindsight_knows_the_plain_reward_and_observation_only(tmp_path, changes):
    with pytest.raises(ConfigurationError, match="relabelled to 0"):
        train(small().changed(**changes), out=tmp_path / "run", seed=0)
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "env_options", "changes"),
    [
        ("armctl/ArmReach-v0", {}, {"shaping": "distance"}),
        ("armctl/ArmReachMoving-v0", {}, {}),
        ("armctl/BridgeCross-v0", {"resolution": [8, 6]}, {}),
        ("armctl/BridgeCross-v0", {"observation": "state"}, {}),
    ],
)
def test_other_tasks_and_rewards_are_learnt_without_hindsight(
    tmp_path, monkeypatch, unexported, env, env_options, changes
):
    monkeypatch.setattr(GoalVectorEnv, "__init__", None)
    short = {**env_options, "max_episode_steps": 10}
    recipe = small(steps=240, random_steps=120, evaluation_every=240, relabelled=0 if changes else 4)
    recipe = recipe.changed(env=env, env_options=short, **changes)
    assert train(recipe, out=tmp_path / "run", seed=0, progress=False).env == env


def test_noise_differs_from_world_to_world():
    noise = _noise(SacOptions(worlds=3, noise=0.4), (6,))
    played = np.array([noise() for _ in range(2000)])
    assert (played[:, 0] == 0).all()
    assert played[:, 1].std() == pytest.approx(0.2 / np.sqrt(0.2), rel=0.15)
    assert played[:, 2].std() == pytest.approx(0.4 / np.sqrt(0.2), rel=0.15)
    lasting = np.corrcoef(played[:-1, 2].ravel(), played[1:, 2].ravel())[0, 1]
    assert lasting == pytest.approx(0.9, abs=0.05)


@pytest.mark.slow
def test_the_rate_decays_and_the_entropy_is_tuned_to_its_target(tmp_path, unexported):
    train(small(target_entropy=0.5), out=tmp_path / "small", seed=1, progress=False)
    model = checkpoint(tmp_path / "small", 800)
    assert model.target_entropy == 0.5 * 6
    assert [model.lr_schedule(left) for left in (1.0, 0.5, 0.0)] == pytest.approx([1e-3, 5e-4, 5e-5])


def test_hindsight_has_the_tolerance_of_the_training(tmp_path):
    chosen = small().changed(training_options={"tolerance": 0.2})
    training = Training(chosen, chosen.read_options(SacOptions), tmp_path / "run", 0, False)
    assert training.held_out.task.options.tolerance == 0.05
    assert _make_vec_env(training, training.options).task.options.tolerance == 0.2
