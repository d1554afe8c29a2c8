import numpy as np
import pytest
import torch

from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.kinematics import ArmModel
from armctl.rl.networks.actor import Actor, EncodedActor
from armctl.rl.networks.box_distance_features import ABSENT, BoxDistanceFeatures, BoxFrames
from armctl.rl.networks.layers import frame_of
from armctl.rl.networks.view import view_of
from armctl.scene import Boxes
from armctl.tasks import ReachScenesTask

from .exported import check_graph


@pytest.fixture(scope="module")
def scenes():
    return TaskVectorEnv(4, task=ReachScenesTask, scenes="box,table_pick")


def features_of(worlds):
    view = view_of(worlds, features="model")
    assert view.features is BoxDistanceFeatures
    return view.features(worlds.single_observation_space, **view.features_options)


def drawn(rng, count):
    """Boxes and what networks observe of them, among two absent ones."""
    boxes = Boxes(
        rng.uniform(-1, 1, (count, 3)), rng.uniform(0.05, 0.3, (count, 3)), *rng.uniform(-1.5, 1.5, (2, count))
    )
    numbers = np.zeros((count + 2, 8))
    numbers[1 : count + 1] = np.column_stack((boxes.centres, boxes.half_sizes, boxes.yaws, boxes.tilts))
    return boxes, torch.as_tensor(numbers)[None]


def test_distances_and_directions_from_tilted_boxes():
    rng = np.random.default_rng(1)
    boxes, numbers = drawn(rng, 7)
    points = rng.uniform(-1.2, 1.2, (200, 3))
    frames = BoxFrames(numbers)
    distances, directions = frames.nearest(torch.as_tensor(points)[None])
    expected = boxes.distances(points).min(axis=-1)
    outside = expected > 0.01
    assert 20 < outside.sum() < len(points)
    np.testing.assert_allclose(distances[0].numpy()[outside], expected[outside], atol=1e-9)
    assert (distances[0].numpy()[expected < -1e-9] < 0).all()
    torch.testing.assert_close(frames.distances(torch.as_tensor(points)[None]), distances)
    moved = frames.distances(torch.as_tensor(points)[None] + 0.005 * directions)
    gained = (moved - distances)[0].numpy()[outside]
    assert (abs(gained - 0.005) < 0.0006).mean() > 0.97  # elsewhere, another box is nearer then


def test_without_boxes_everything_is_far():
    distances, directions = BoxFrames(torch.zeros(2, 3, 8)).nearest(torch.rand(2, 5, 3))
    assert (distances > ABSENT / 2).all()
    assert torch.isfinite(directions).all()


def test_the_order_of_boxes_does_not_matter_and_each_part_of_the_observation_does(scenes):
    features = features_of(scenes)
    observations = torch.as_tensor(scenes.reset(seed=1)[0])
    before = features(observations)
    assert before.shape == (4, features.features_dim)
    assert torch.isfinite(before).all()
    assert before.abs().max() < 20
    turned = observations.clone()
    turned[:, 24:] = observations[:, 24:].unflatten(1, (-1, 8)).flip(1).flatten(1)
    torch.testing.assert_close(features(turned), before, atol=1e-5, rtol=1e-5)
    for part in (slice(0, 3), slice(3, 9), slice(9, 12), slice(12, 18), slice(18, 24), slice(24, None)):
        other = observations.clone()
        other[:, part] = observations.roll(1, 0)[:, part] + 0.01
        assert not torch.allclose(features(other), before)


def test_features_have_no_weights_and_examples_of_them_have_the_same_loss(scenes):
    view = view_of(scenes, features="model")
    assert view.has_fixed_features(scenes.single_observation_space)
    features = features_of(scenes)
    network = torch.nn.Sequential(features, torch.nn.Linear(features.features_dim, 6))
    observations = scenes.reset(seed=2)[0]
    actions = observations[:, 3:9] + np.float32(0.1)
    actor = EncodedActor(network, view.action_scale, scenes.single_observation_space)
    plain = Actor(network, view.action_scale, scenes.single_observation_space)
    encoded = map(torch.as_tensor, actor.encoded(observations, actions))
    torch.testing.assert_close(
        actor.loss(*encoded), plain.loss(torch.as_tensor(observations), torch.as_tensor(actions)), rtol=1e-4, atol=1e-5
    )


def test_the_way_that_is_missing_to_the_goal_vanishes_there(scenes):
    """The goal is a configuration at the pose that is free of boxes, in 19 of 20 problems that of the planner."""
    features, task = features_of(scenes), scenes.task
    model, agreed = ArmModel(task.robot), []
    for seed in range(5):
        observations = torch.as_tensor(scenes.reset(seed=seed)[0])
        _, _, target, axes, numbers = observations.split(features.parts, dim=1)
        pairs = axes.unflatten(1, (4, 3))
        boxes = BoxFrames(numbers.unflatten(1, (-1, 8)))
        goals = features._goal(target, frame_of(pairs[:, 2:]), boxes).double().numpy()
        for world, goal in enumerate(goals):
            pose = model.pose(goal)
            np.testing.assert_allclose(pose[:3, 3], target[world], atol=2e-3)
            np.testing.assert_allclose(pose[:3, :2].T, pairs[world, 2:], atol=5e-3)
            agreed.append(task.min_clearance(world, goal[None]) > 0)
    assert np.mean(agreed) >= 0.9


def test_turns_of_a_goal_are_within_the_limits(scenes):
    features = features_of(scenes)
    joints = torch.tensor([[3.0, -3.0, 0.0, 1.0, 2.0, -2.0]])
    near = features._nearest_turn(torch.tensor([[-3.0, 3.0, 0.5, 1.0, -2.0, 2.0]]), joints)
    torch.testing.assert_close(near, torch.tensor([[-3.0, 3.0, 0.5, 1.0, -2.0, 2.0]]))  # its limits are +-pi
    features.lower, features.upper = -2 * features.upper, 2 * features.upper
    near = features._nearest_turn(torch.tensor([[-3.0, 3.0, 0.5, 1.0, -2.0, 2.0]]), joints)
    turn = 2 * np.pi
    torch.testing.assert_close(near, torch.tensor([[-3.0 + turn, 3.0 - turn, 0.5, 1.0, -2.0 + turn, 2.0 - turn]]))


def test_postures_are_a_feature_of_arms_that_have_them():
    worlds = [TaskVectorEnv(1, task=ReachScenesTask, robot=robot) for robot in ("ur5_robotiq85", "panda_open")]
    assert [features_of(env).postures is not None for env in worlds] == [True, False]
    assert all(torch.isfinite(features_of(env)(torch.as_tensor(env.reset(seed=3)[0]))).all() for env in worlds)


def test_other_observations_are_refused(scenes):
    space = TaskVectorEnv(1, task=ReachScenesTask, observation="full").single_observation_space
    with pytest.raises(ConfigurationError, match="ends with boxes"):
        BoxDistanceFeatures(space, view_of(scenes, features="model").features_options["geometry"])


@pytest.mark.slow
def test_the_graph_acts_like_the_network_in_any_number_of_worlds(scenes, tmp_path):
    check_graph(scenes, features_of(scenes), tmp_path)
