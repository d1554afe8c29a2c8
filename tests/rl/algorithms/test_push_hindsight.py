"""Hindsight in `armctl/ArmPush-v0`: a goal is a place of the object at rest, and an object that fell is lost."""

import numpy as np
import pytest
import torch

from armctl.envs import TaskVectorEnv
from armctl.rl.algorithms.hindsight import GoalVectorEnv, HindsightBuffer
from armctl.rl.networks.frames import History
from armctl.rl.networks.view import view_of
from armctl.scene import push_table
from armctl.tasks import PushTask
from armctl.tasks.reach.state import GOAL_REWARD, STEP_REWARD
from armctl.tasks.tabletop.state import FELL_REWARD

N, SCALE, TARGET = 6, 0.1, slice(9, 11)
AT_REST, NEAR, SLIDING, FALLING = 0, 1, 2, 3
"""Worlds in which the object stays where it is, or at the target, slides to a halt, or falls off the table."""


@pytest.fixture(scope="module")
def played():
    """Worlds and a buffer with two episodes of each."""
    env = TaskVectorEnv(
        N, task=PushTask, autoreset_mode="same_step", max_episode_steps=12, reward_scale=SCALE, threads=1
    )
    view = view_of(env)
    worlds = GoalVectorEnv(History(view, env.single_observation_space, 2), env, view)
    worlds.seed(0)
    buffer = HindsightBuffer(N * 24, worlds.observation_space, worlds.action_space, worlds, n_envs=N, n_sampled_goal=4)
    shown, idle = worlds.reset(), np.zeros((N, 6), dtype=np.float32)
    put(env.task)
    for _ in range(24):
        following, rewards, done, infos = worlds.step(idle)
        if done[FALLING]:
            put(env.task)
        ends = {name: values.copy() for name, values in following.items()}
        for i in np.flatnonzero(done):
            for name, values in infos[i]["terminal_observation"].items():
                ends[name][i] = values
        buffer.add(shown, ends, idle, rewards, done, infos)
        shown = following
    return worlds, buffer


def put(task):
    """Place the objects so that the worlds have their fates."""
    pose, velocity = task._object_qpos, task._object_qvel
    pose[NEAR, :2] = task.state.target_position[NEAR, :2] + (0.02, 0.01)
    pose[SLIDING, :2] = task.state.target_position[SLIDING, :2]
    velocity[SLIDING, 0] = 0.5
    pose[FALLING, 2] = push_table.TOOL_HEIGHT - 0.2
    task.simulation.refresh()


@pytest.mark.slow
def test_each_reward_is_that_of_the_goals_and_of_objects_that_fell(played):
    worlds, buffer = played
    achieved, desired = (buffer.next_observations[name] for name in ("achieved_goal", "desired_goal"))
    for world in range(N):
        expected = worlds.compute_reward(achieved[:, world], desired[:, world])
        fell = (buffer.dones > buffer.timeouts)[:, world] & (world == FALLING)
        np.testing.assert_array_equal(buffer.rewards[:, world], np.float32(expected + SCALE * FELL_REWARD * fell))
    assert (buffer.rewards[:, NEAR] > 0).any()
    assert (buffer.rewards[:, FALLING] < SCALE * FELL_REWARD).any()


@pytest.fixture(scope="module")
def relabelled(played):
    _, buffer = played
    np.random.seed(0)  # noqa: NPY002 - Stable-Baselines3 draws from it
    steps, worlds = (np.tile(indices, 5) for indices in np.nonzero(buffer.ep_length))
    return steps, worlds, buffer._get_virtual_samples(steps, worlds)


def test_a_relabelled_success_is_an_object_at_rest_near_the_new_target(played, relabelled):
    steps, worlds, samples = relabelled
    _, buffer = played
    achieved = samples.next_observations["achieved_goal"].numpy()
    desired = samples.next_observations["desired_goal"].numpy()
    won = samples.rewards[:, 0].numpy() > 0
    expected = (np.hypot(*(achieved - desired)[:, :2].T) <= 0.03) & (achieved[:, 2] == 1)
    np.testing.assert_array_equal(won, expected)
    passes = (worlds == SLIDING) & (np.hypot(*(achieved - desired)[:, :2].T) <= 0.03) & (achieved[:, 2] == 0)
    assert passes.any()
    assert (samples.rewards[passes] == np.float32(SCALE * STEP_REWARD)).all()
    assert (samples.rewards[won] == np.float32(SCALE * (STEP_REWARD + GOAL_REWARD))).all()
    assert samples.dones[won].all()
    fell = (buffer.dones > buffer.timeouts)[steps, worlds] & (worlds == FALLING)
    np.testing.assert_array_equal(samples.dones[:, 0] == 1, won | fell)


def test_an_object_that_fell_is_lost_for_any_target(played, relabelled):
    steps, worlds, samples = relabelled
    _, buffer = played
    lost = (buffer.dones > buffer.timeouts)[steps, worlds] & (worlds == FALLING)
    assert lost.any()
    assert samples.dones[lost].all()
    np.testing.assert_array_equal(samples.rewards[lost, 0], buffer.rewards[steps, worlds][lost])


def test_relabelled_observations_show_the_new_target_and_are_otherwise_as_they_were(played, relabelled):
    steps, worlds, samples = relabelled
    _, buffer = played
    for kept, shown in (
        (buffer.observations, samples.observations), (buffer.next_observations, samples.next_observations)
    ):  # fmt: skip
        stacks, goal = shown["observation"].clone(), shown["desired_goal"][:, None, :2].float()
        assert (stacks[..., TARGET] == goal).all()
        before = torch.as_tensor(kept["observation"][steps, worlds])
        assert (before[..., TARGET] != stacks[..., TARGET]).any()
        stacks[..., TARGET] = before[..., TARGET]
        assert torch.equal(stacks, before)
