from typing import Any

import gymnasium
import numpy as np
import pytest

from armctl.envs import TaskVectorEnv
from armctl.rl.networks.view import view_of
from armctl.rl.run.vector import StableBaselinesVectorEnv
from armctl.shaping import Shaped
from armctl.tasks import BridgeTask, ReachTask

CAMERA: dict[str, Any] = {"resolution": (8, 6)}


def adapter(worlds, *, shaping=None, **options):
    env = TaskVectorEnv(worlds, task=ReachTask, autoreset_mode="same_step", **options)
    shaped = Shaped(env, shaping, gamma=0.9, scale=50.0) if shaping else env
    return StableBaselinesVectorEnv(shaped, view_of(env))


def test_adapter_tells_of_ended_episodes():
    venv = adapter(6, max_episode_steps=3)
    venv.seed(5)
    start = venv.reset()
    for _ in range(3):
        observations, rewards, done, infos = venv.step(np.zeros((6, 6), dtype=np.float32))
    assert done.all()
    assert (rewards == -1).all()
    for world, info in enumerate(infos):
        assert info["TimeLimit.truncated"]
        assert (info["episode"]["r"], info["episode"]["l"]) == (-3.0, 3)
        assert not info["is_success"]
        np.testing.assert_allclose(info["terminal_observation"][9:], start[world, 9:])
    assert not np.allclose(observations[:, 9:], start[:, 9:])


def test_rewards_are_weighted_and_shaped_and_returns_are_not():
    venv = adapter(8, reward_scale=0.1, reward_weights={"step": 0.5}, shaping="distance", max_episode_steps=2)
    venv.seed(0)
    before = venv.reset()
    rng = np.random.default_rng(0)
    after, rewards, *_ = venv.step(rng.uniform(-1, 1, (8, 6)).astype(np.float32))
    near, far = (np.linalg.norm(seen[:, :3] - seen[:, 9:], axis=1) for seen in (after, before))
    assert np.ptp(far - near) > 0.001
    np.testing.assert_allclose(rewards, 0.1 * (-0.5 + 50 * (far - 0.9 * near)), atol=1e-4)
    *_, infos = venv.step(np.zeros((8, 6), dtype=np.float32))
    assert [info["episode"]["r"] for info in infos] == [-2.0] * 8


def test_the_learner_sees_the_last_observation_of_an_episode_and_the_first_of_the_next():
    env = TaskVectorEnv(4, task=BridgeTask, autoreset_mode="same_step", max_episode_steps=5, **CAMERA)
    venv = StableBaselinesVectorEnv(env, view_of(env))
    venv.seed(0)
    first = venv.reset()
    for _ in range(5):
        observations, _, done, infos = venv.step(np.zeros((4, 2), dtype=np.float32))
    assert done.all()
    for world in range(4):
        last = infos[world]["terminal_observation"]
        assert infos[world]["TimeLimit.truncated"]
        assert last["image"].shape == (6, 8)
        assert last["motion"][0] > 0.1
        np.testing.assert_array_equal(observations["motion"][world], 0.0)
        assert not np.array_equal(last["image"], observations["image"][world])
    assert first["image"].shape == observations["image"].shape


def test_another_autoreset_mode_is_refused():
    env = gymnasium.make_vec("armctl/ArmReach-v0", num_envs=2)
    with pytest.raises(ValueError, match="same_step"):
        StableBaselinesVectorEnv(env, view_of(env))
