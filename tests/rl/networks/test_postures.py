import numpy as np
import pytest
import torch

from armctl.kinematics import ArmModel
from armctl.rl.networks.postures import POSTURES, Postures


def poses_of(model, configurations):
    poses = torch.as_tensor(np.array([model.pose(q) for q in configurations]), dtype=torch.float32)
    return poses[:, :3, 3], poses[:, :3, :3].transpose(1, 2)


@pytest.mark.parametrize("robot", ["ur3", "ur5", "ur10", "ur5_robotiq85"])
def test_all_postures_are_at_the_pose_and_one_is_where_it_came_from(robot):
    model = ArmModel(robot)
    q = model.random_configurations(np.random.default_rng(0), 150)
    q = q[abs(np.sin(q[:, [2, 4]])).min(axis=1) > 0.1]  # elsewhere, two postures are nearly one
    places, axes = poses_of(model, q)
    found, exist = Postures.of(model.geometry())(places, axes)
    assert found.shape == (len(q), POSTURES, 6)
    assert found.abs().max() <= np.pi + 1e-6
    assert exist.sum(dim=1).min() >= 2
    rows, postures = exist.nonzero(as_tuple=True)
    reached_places, reached_axes = poses_of(model, found[rows, postures].double().numpy())
    assert (reached_places - places[rows]).abs().max() < 1e-3
    assert (reached_axes - axes[rows]).abs().max() < 1e-3
    turns = (found.numpy() - q[:, None]) / (2 * np.pi)
    assert abs(2 * np.pi * (turns - turns.round())).max(axis=2).min(axis=1).max() < 5e-3


def test_postures_differ_in_shoulder_wrist_and_elbow():
    model = ArmModel("ur5")
    places, axes = poses_of(model, model.random_configurations(np.random.default_rng(2), 100))
    found, _ = Postures.of(model.geometry())(places, axes)
    behind = torch.cos(found[..., 0] - torch.atan2(places[:, 1], places[:, 0])[:, None])
    assert (behind[:, :4] <= behind[:, 4:] + 1e-5).all()
    assert (found[:, [0, 1, 4, 5], 4] <= 1e-6).all()
    assert (found[:, [2, 3, 6, 7], 4] >= -1e-6).all()
    assert (found[:, ::2, 2].sin() >= -1e-5).all()
    assert (found[:, 1::2, 2].sin() <= 1e-5).all()


def test_poses_out_of_reach_give_finite_numbers_that_are_marked():
    model = ArmModel("ur5")
    postures = Postures.of(model.geometry())
    places, axes = poses_of(model, model.random_configurations(np.random.default_rng(1), 50))
    for scale in (0.0, 0.01, 5.0):
        found, exist = postures(scale * places, axes)
        assert torch.isfinite(found).all()
        assert scale < 1 or not exist.any()


@pytest.mark.parametrize("robot", ["panda_open", "xarm7"])
def test_other_arms_have_none(robot):
    assert Postures.of(ArmModel(robot).geometry()) is None
