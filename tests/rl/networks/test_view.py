from typing import Any

import numpy as np
import pytest
import torch

from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.rl.networks.actor import Actor, tensors
from armctl.rl.networks.layers import missing_turn
from armctl.rl.networks.view import view_of
from armctl.robots.arm import LARGEST_RELATIVE_MOVE
from armctl.tasks import OBSERVATION, BridgeTask, ReachMovingTask, ReachObstaclesTask, ReachPoseTask, ReachTask

CAMERA: dict[str, Any] = {"resolution": (8, 6)}
WORLDS = {
    "reach": lambda: TaskVectorEnv(5, task=ReachTask),
    "features": lambda: TaskVectorEnv(
        5, task=ReachTask, observation="features", control="relative", actions="normalized"
    ),
    "normalized": lambda: TaskVectorEnv(5, task=ReachTask, actions="normalized"),
    "panda": lambda: TaskVectorEnv(5, task=ReachTask, robot="panda"),
    "moving": lambda: TaskVectorEnv(5, task=ReachMovingTask),
    "pose": lambda: TaskVectorEnv(5, task=ReachPoseTask),
    "obstacles": lambda: TaskVectorEnv(5, task=ReachObstaclesTask, solvable=False),
    "depth": lambda: TaskVectorEnv(5, task=BridgeTask, **CAMERA),
    "classes": lambda: TaskVectorEnv(5, task=BridgeTask, camera="classes", **CAMERA),
    "state": lambda: TaskVectorEnv(5, task=BridgeTask, observation="state"),
}


@pytest.mark.one_case
@pytest.mark.parametrize("features", ["none", "plain", "invariant"])
@pytest.mark.parametrize("name", WORLDS)
def test_a_network_can_act_in_every_task(name, features):
    worlds = WORLDS[name]()
    view = view_of(worlds, features=features)
    observations, _ = worlds.reset(seed=0)
    extractor = view.extractor(worlds.single_observation_space)
    network = torch.nn.Sequential(
        extractor, torch.nn.Linear(extractor.features_dim, worlds.single_action_space.shape[0])
    )
    before = extractor(tensors(observations))
    assert before.shape == (5, extractor.features_dim)
    assert torch.isfinite(before).all()
    actor = Actor(network, view.action_scale, worlds.single_observation_space)
    for action in actor.act(observations):
        assert worlds.single_action_space.contains(action)


@pytest.mark.parametrize("name", ["moving", "obstacles"])
def test_the_whole_observation_is_shown(name):
    worlds = WORLDS[name]()
    observations, _ = worlds.reset(seed=0)
    view = view_of(worlds)
    extractor = view.extractor(worlds.single_observation_space)
    shown = torch.as_tensor(observations[:1]).requires_grad_()
    torch.linalg.norm(extractor(shown) + 1.0).backward()
    assert (shown.grad != 0).all()


def test_the_missing_turn_is_that_from_the_end_effector_to_the_target():
    worlds = WORLDS["pose"]()
    axes = torch.as_tensor(worlds.reset(seed=0)[0][:, 12:]).unflatten(1, (2, 2, 3))
    features = missing_turn(axes[:, 0], axes[:, 1]).numpy()
    angles = worlds.task.state.angle
    np.testing.assert_allclose(
        np.trace(features[:, :9].reshape(-1, 3, 3), axis1=1, axis2=2), 1 + 2 * np.cos(angles), atol=1e-5
    )
    np.testing.assert_allclose(np.linalg.norm(features[:, 9:12], axis=1), 2 * np.sin(angles), atol=1e-5)
    np.testing.assert_allclose(features[:, 12], np.sqrt(8) * np.sin(angles / 2), atol=1e-5)


@pytest.mark.parametrize("control", ["position", "delta", "velocity", "torque"])
def test_scaled_actions_lie_in_the_action_space(control):
    env = TaskVectorEnv(40, task=ReachTask, control=control)
    observations, _ = env.reset(seed=0)
    scale = view_of(env).action_scale
    raw = torch.randn(40, 6) * 3
    for action in scale(torch.as_tensor(observations), raw).numpy():
        assert env.single_action_space.contains(action)


@pytest.mark.parametrize("name", ["reach", "panda", "moving", "obstacles"])
def test_positions_are_commanded_relative_to_the_present_ones(name):
    worlds = WORLDS[name]()
    worlds.reset(seed=0)
    moved, *_ = worlds.step(worlds.action_space.sample())
    raw = torch.linspace(-2, 2, 5)[:, None].expand(worlds.action_space.shape)
    scaled = view_of(worlds).action_scale(torch.as_tensor(moved), raw).numpy()
    joints = worlds.task.state.joint_positions
    np.testing.assert_allclose(scaled - joints, LARGEST_RELATIVE_MOVE * raw.clamp(-1, 1).numpy(), atol=1e-5)


def test_an_observation_in_another_order_is_refused():
    backwards = dict(reversed([*OBSERVATION.items()]))
    with pytest.raises(ConfigurationError, match="begins with end_effector_position"):
        view_of(TaskVectorEnv(1, task=ReachTask, observation=backwards))
