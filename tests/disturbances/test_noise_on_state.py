"""Noise on the state: who reads it gets what who observes it gets, and nothing that is true changes."""

import functools
from contextlib import closing

import numpy as np
import pytest

from armctl.core.registration import environment_names
from armctl.envs import make_worlds
from armctl.policies import WorldsByInterface
from armctl.rollout.construction import build_policy
from armctl.rollout.loop import rollouts
from armctl.study.levels import sweep_levels
from armctl.study.line_up import line_up
from armctl.tasks.bridge.observation import BLOCK, ROVER

MOVING = "armctl/BridgeCrossMoving-v0"
NOISE = {"disturbances": {"noise_on_state": 0.05}}
SPEED = np.array([0.8, 0.1])


def bridges(n=1, **options):
    worlds = make_worlds(MOVING, n, NOISE | options)
    worlds.reset(seed=[7] * n, options={"episode": list(range(n))})
    return worlds


def test_who_reads_the_state_gets_what_who_observes_it_gets():
    with closing(bridges(2)) as read, closing(bridges(2, observation="state")) as shown:
        for _ in range(4):
            (seen, rewards, *_), (_, true_rewards, *_) = (one.step(np.tile(SPEED, (2, 1))) for one in (shown, read))
            perceived, task = read.perceived(), read.task
            np.testing.assert_array_equal(perceived.state_observation(), seen)
            np.testing.assert_array_equal(rewards, true_rewards)
            assert np.abs(seen - task.state_observation()).max() > 0.05
            np.testing.assert_allclose(perceived.state.poses[:, :2], seen[:, :2], rtol=1e-6)
            np.testing.assert_allclose(np.tan(perceived.state.poses[:, 2]), seen[:, 3] / seen[:, 2], rtol=1e-5)
            np.testing.assert_allclose(perceived.state.velocities, seen[:, 4:ROVER], rtol=1e-6)
            for i in range(2):
                believed = perceived.map(i)
                blocks = seen[i, ROVER : ROVER + BLOCK * len(believed.blocks)].reshape(-1, BLOCK)
                np.testing.assert_allclose(believed.blocks, blocks, rtol=1e-6)
                people = seen[i, ROVER + blocks.size :].reshape(-1, 4)[:, :2]
                np.testing.assert_allclose(believed.pedestrians.positions(task.state.time[i]), people, atol=1e-5)


def test_it_is_the_same_with_any_number_of_worlds_and_nothing_else_changes():
    with closing(bridges(3)) as three, closing(bridges(1)) as one, closing(make_worlds(MOVING, 1)) as plain:
        one.reset(seed=7, options={"episode": 2})
        plain.reset(seed=7, options={"episode": 2})
        for _ in range(3):
            three.step(np.tile(SPEED, (3, 1)))
            _, rewards, *_ = one.step(SPEED[None])
            _, undisturbed, *_ = plain.step(SPEED[None])
            numbers = three.perceived().state_observation()
            np.testing.assert_array_equal(numbers[2:], one.perceived().state_observation())
            np.testing.assert_array_equal(one.perceived().state_observation(), numbers[2:])  # also when asked again
            np.testing.assert_array_equal(one.task.state.poses, plain.task.state.poses)
            np.testing.assert_array_equal(rewards, undisturbed)
        assert plain.perceived() is plain.task


@functools.cache
def played(policies, env, disturbances, steps, episodes):
    """By policy: return, length and path of each episode, and whether all disturbances are said to spare it."""
    options = {"max_episode_steps": steps, "disturbances": dict(disturbances)}
    rows = {}
    with closing(WorldsByInterface(env, episodes, options)) as interfaces:
        for policy in policies:
            worlds = interfaces.of(policy)
            actor = build_policy(policy, worlds, policy, policy_seed=0)
            results = rollouts(actor, worlds, episodes, 0, policy, dict.fromkeys(range(episodes), 0.0))
            measured = {one.episode: (one.total_reward, one.length, one.metrics.path_length) for one in results}
            rows[policy] = measured, bool(interfaces.spared(policy, actor))
    return rows


def differing(policies, env, disturbance, level, steps, episodes):
    """By policy: whether its episodes differ from the undisturbed ones, and whether it is told as spared."""
    plain = played(tuple(policies), env, (), steps, episodes)
    disturbed = played(tuple(policies), env, ((disturbance, level),), steps, episodes)
    return {policy: (plain[policy][0] != measured, spared) for policy, (measured, spared) in disturbed.items()}


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("disturbance", "expected"),
    [
        ("noise", {"bridge_mpc": (False, True), "bridge_state_ppo": (True, False)}),
        ("noise_on_state", {"bridge_mpc": (True, False), "bridge_state_ppo": (True, False)}),
    ],
)
def test_noise_reaches_experts_only_on_the_state(disturbance, expected):
    assert differing([*expected], "armctl/BridgeCross-v0", disturbance, 0.2, steps=12, episodes=1) == expected


LIKE_OTHERS = ("armctl/ArmScenes-v0", "armctl/BarnCross-v0", "armctl/BarnCrossMoving-v0")
"""Tasks whose policies and disturbances are those of others."""
TASKS = [name for name in environment_names() if name.startswith("armctl/") and name not in LIKE_OTHERS]


@pytest.mark.slow
@pytest.mark.parametrize("env", TASKS)
def test_each_disturbance_reaches_each_policy_or_spares_it(env):
    """Every installed policy of every task, at the strongest level: none is neither changed nor told as spared."""
    policies = [*line_up(env), "random"]
    for disturbance, levels in sweep_levels(env).items():
        # Some are pushed in their second second only, and some lose no picture that matters before.
        steps, episodes = (25, 2) if disturbance in ("pushes", "dropout") else (8, 1)
        found = differing(policies, env, disturbance, levels[-1], steps, episodes)
        assert found.pop("random")[1] == (disturbance in ("noise", "noise_on_state", "dropout"))  # it reads nothing
        for policy, (changed, spared) in found.items():
            assert changed != spared, (env, disturbance, policy)
        if disturbance == "noise_on_state":
            assert not any(spared for _, spared in found.values())
