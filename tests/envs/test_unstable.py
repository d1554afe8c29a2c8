"""Worlds whose physics fails: their episode ends as `unstable`, and nothing else happens to anything else."""

from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.spaces import Box

from armctl.envs.vector import TaskVectorEnv
from armctl.simulation import Simulation
from armctl.tasks import Outcome, Task

MODES = ("next_step", "same_step", "disabled")
ENVS = (
    "armctl/ArmLift-v0", "armctl/ArmPose-v0", "armctl/ArmPush-v0", "armctl/ArmReach-v0",
    "armctl/ArmReachMoving-v0", "armctl/ArmReachObstacles-v0", "armctl/ArmScenes-v0", "armctl/BarnCross-v0",
    "armctl/BarnCrossMoving-v0", "armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0",
)  # fmt: skip


class CartOutcome(Outcome):
    TIMEOUT = 0
    THERE = 1, True


class Cart(Task):
    """A stranger's task: a cart on a rail, whose reward is infinite if its position is."""

    outcomes = CartOutcome
    observation_space = Box(-np.inf, np.inf, (2,), dtype=np.float32)
    action_space = Box(-1, 1, (1,), dtype=np.float32)

    def __init__(self, n, options, threads=0):
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body()
        body.add_joint(name="rail", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1, 0, 0])
        body.add_geom(size=[0.1, 0, 0])
        motor = spec.add_actuator(name="motor", target="rail", trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        super().__init__(Simulation(spec.compile(), n, threads), 0.02)
        self.place, self.speed = self.simulation.array("qpos"), self.simulation.array("qvel")

    def reset(self, ids, rngs):
        self.simulation.reset(ids)
        self.place[ids, 0] = [rng.uniform() for rng in rngs]
        self.simulation.refresh(ids)

    def command(self, actions):
        self.simulation.array("ctrl")[:] = actions

    def observe(self, ids=None):
        seen = np.hstack((self.place, self.speed)).astype(np.float32)
        return seen if ids is None else seen[ids]

    def reward_terms(self):
        return {"place": self.place[:, 0] ** 2, "step": -np.ones(self.n)}

    def outcome(self):
        return np.zeros(self.n, dtype=np.int8)


def worlds(env, n=3, mode="next_step", **options):
    if env == "cart":
        return TaskVectorEnv(n, task=Cart, autoreset_mode=mode, threads=1, max_episode_steps=50)
    small: dict[str, Any] = {"resolution": (8, 6)} if "Bridge" in env else {}
    return gymnasium.make_vec(env, num_envs=n, autoreset_mode=mode, threads=1, **small, **options)


def parts(observations):
    return observations if isinstance(observations, dict) else {"": observations}


def idle(env):
    return np.tile(env.unwrapped.task.idle_action, (env.num_envs, 1))


def break_world(env, world=1, number=np.nan):
    env.unwrapped.task.simulation.array("qvel")[world] = number


@pytest.mark.one_case
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env", ["cart", *ENVS])
def test_the_episode_ends_as_unstable_and_the_next_one_is_as_in_a_fresh_environment(env, mode, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    broken, whole = worlds(env, mode=mode), worlds(env, mode=mode)
    for made in (broken, whole):
        made.reset(seed=4)
        made.step(idle(made))
    break_world(broken, 1)
    seen, rewards, terminated, truncated, infos = broken.step(idle(broken))
    expected = whole.step(idle(whole))
    ended = infos["final_info"] if mode == "same_step" else infos
    unstable = broken.outcomes.index("unstable")
    assert ended["outcome_id"][1] == unstable
    assert unstable not in ended["outcome_id"][[0, 2]]
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert ended["is_success"][1] == False  # noqa: E712
    assert rewards[1] == 0
    assert all(earned[1] == 0 for earned in ended["reward_terms"].values())
    for name, values in parts(infos["final_obs"] if mode == "same_step" else seen).items():
        assert np.isfinite(values).all()
        assert np.array_equal(values[[0, 2]], parts(expected[0])[name][[0, 2]])
    assert np.array_equal(rewards[[0, 2]], expected[1][[0, 2]])

    if mode == "next_step":
        seen, *_ = broken.step(idle(broken))
    elif mode == "disabled":
        seen, _ = broken.reset(options={"reset_mask": np.array([False, True, False])})
    fresh = worlds(env, mode=mode)
    fresh_seen, _ = fresh.reset(seed=4, options={"episode": [0, 1, 0]})
    for _ in range(4):
        assert all(np.array_equal(parts(seen)[name][1], values[1]) for name, values in parts(fresh_seen).items())
        seen, rewards, *_ = broken.step(idle(broken))
        fresh_seen, fresh_rewards, *_ = fresh.step(idle(fresh))
        assert rewards[1] == fresh_rewards[1]
    assert not list(tmp_path.iterdir())


@pytest.mark.one_case
@pytest.mark.parametrize("env", ENVS)
def test_a_world_that_stands_still_after_it_has_become_unstable_changes_nothing(env):
    broken, whole = worlds(env, mode="disabled"), worlds(env, mode="disabled")
    for made in (broken, whole):
        made.reset(seed=1)
    break_world(broken, 0, 1e200)
    for _ in range(5):
        seen, rewards, terminated, *_ = broken.step(idle(broken))
        expected = whole.step(idle(whole))
        for name, values in parts(seen).items():
            assert np.isfinite(values).all()
            assert np.array_equal(values[1:], parts(expected[0])[name][1:])
        assert np.array_equal(rewards[1:], expected[1][1:])
    assert not terminated[0]
    assert rewards[0] == 0


def test_a_single_environment_ends_too():
    env = gymnasium.make("armctl/ArmReach-v0")
    env.reset(seed=0)
    break_world(env, 0)
    observation, reward, terminated, truncated, info = env.step(env.get_wrapper_attr("task").idle_action)
    assert (info["outcome"], info["is_success"], reward, terminated, truncated) == ("unstable", False, 0.0, True, False)
    assert np.isfinite(observation).all()
