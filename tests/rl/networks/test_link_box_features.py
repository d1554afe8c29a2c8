import numpy as np
import pytest
import torch

from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.kinematics import ArmModel
from armctl.rl.networks.link_box_features import LENGTH_SCALE, NEARBY, LinkBoxFeatures
from armctl.rl.networks.view import view_of
from armctl.scene import Boxes
from armctl.tasks import ReachObstaclesTask, ReachTask

from .exported import check_graph


@pytest.fixture(scope="module")
def worlds():
    return TaskVectorEnv(6, task=ReachObstaclesTask)


@pytest.fixture(scope="module")
def features(worlds):
    torch.manual_seed(0)
    view = view_of(worlds, features="model")
    return view.features(worlds.single_observation_space, **view.features_options)


def test_points_are_where_the_arm_s_links_are(features):
    model = ArmModel("ur5")
    geometry = model.geometry()
    q = model.random_configurations(np.random.default_rng(0), 10)
    found = features.links(torch.as_tensor(q, dtype=torch.float32)).numpy()
    order = [i for points in features.links.points_of for i in points]
    for angles, points in zip(q, found, strict=True):
        model.placement(angles)
        for i, point in zip(order, points, strict=True):
            expected = model._data.oMi[geometry["joint"][i]].act(np.array(geometry["points"][i]))
            np.testing.assert_allclose(point, expected, atol=1e-5)


def test_points_cover_the_links():
    """Every point of a moving link's segment is within the spacing of one of its points."""
    model = ArmModel("ur5")
    geometry = model.geometry(spacing=0.1)
    points = np.array(geometry["points"])
    for link in model.links[model.links["joint"] > 0]:
        own = points[np.array(geometry["joint"]) == link["joint"]]
        for share in np.linspace(0, 1, 20):
            at = link["start"] + share * (link["end"] - link["start"])
            assert np.linalg.norm(own - at, axis=1).min() <= 0.1


def test_distances_from_boxes():
    rng = np.random.default_rng(1)
    boxes = Boxes(rng.uniform(-1, 1, (7, 3)), rng.uniform(0.05, 0.4, (7, 3)), rng.uniform(-1.5, 1.5, 7))
    points, radii = rng.uniform(-1, 1, (9, 3)), rng.uniform(0, 0.1, 9)
    given = (points, boxes.centres, boxes.half_sizes, boxes.yaws[:, None], radii)
    tensors = [torch.as_tensor(one)[None] for one in given[:-1]]
    seen = LinkBoxFeatures.seen_from(*tensors, torch.as_tensor(radii))[0].numpy()
    expected = np.maximum(boxes.distances(points), 0.0).T - radii
    np.testing.assert_allclose(seen[..., 6] / LENGTH_SCALE, expected, atol=1e-9)
    np.testing.assert_allclose(seen[..., 7], NEARBY / (NEARBY + np.maximum(expected, 0)), atol=1e-9)


def test_turning_the_scene_or_a_box_by_half_a_turn_changes_nothing(worlds, features):
    observations, _ = worlds.reset(seed=1)
    boxes = observations[:, 12:].reshape(6, -1, 7)
    turned, angle = observations.copy(), 0.7
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    turned[:, :3], turned[:, 9:12] = observations[:, :3] @ turn.T, observations[:, 9:12] @ turn.T
    turned[:, 3] += angle
    present = (boxes[..., 3:6] > 0).all(axis=-1, keepdims=True)
    yaws = boxes[..., 6:] + (angle + np.pi) * present
    turned[:, 12:] = np.concatenate((boxes[..., :3] @ turn.T, boxes[..., 3:6], yaws), axis=-1).reshape(6, -1)
    before, after = (features(torch.as_tensor(one)).detach().numpy() for one in (observations, turned))
    np.testing.assert_allclose(after, before, atol=1e-4)


def test_the_order_of_boxes_does_not_matter_and_the_boxes_do(worlds, features):
    observations, _ = worlds.reset(seed=2)
    other = observations.copy()
    other[:, 12:] = observations[:, 12:].reshape(6, -1, 7)[:, ::-1].reshape(6, -1)
    before, after = (features(torch.as_tensor(one)) for one in (observations, other))
    torch.testing.assert_close(after, before)
    other[:, 12:] = 0.0
    assert not torch.allclose(features(torch.as_tensor(other)), before)


@pytest.mark.slow
def test_the_graph_acts_like_the_network_in_any_number_of_worlds(worlds, features, tmp_path):
    check_graph(worlds, features, tmp_path)


def test_only_the_task_with_boxes_has_such_features(worlds):
    with pytest.raises(ConfigurationError, match="robot's geometry"):
        view_of(TaskVectorEnv(1, task=ReachTask), features="model")
    with pytest.raises(ConfigurationError, match="robot's geometry"):
        view_of(TaskVectorEnv(1, task=ReachObstaclesTask, observation="full", solvable=False), features="model")
    view = view_of(worlds, features="model")
    with pytest.raises(ConfigurationError, match="boxes"):
        view.features(TaskVectorEnv(1, task=ReachTask).single_observation_space, **view.features_options)
