"""Configurations in lanes have the frames, and the twists to a pose, that Pinocchio has one by one."""

import numpy as np
import pinocchio
import pytest

from armctl.kernels import arm_lanes
from armctl.kinematics import ArmModel
from armctl.robot_description import load_arm

from ..robot_description.palletiser import palletiser
from ..robot_description.sliding_arms import gantry, telescope
from .reference import twist_length

LANES = arm_lanes.LANES


@pytest.fixture(params=["ur5", "panda", palletiser, gantry, telescope])
def model(request, tmp_path):
    if isinstance(request.param, str):
        return ArmModel(request.param)
    path = tmp_path / "arm.urdf"
    path.write_text(request.param())
    return ArmModel(load_arm(path))


@pytest.fixture
def lanes():
    return np.zeros(1, arm_lanes.FRAMES)[0]


def rigid(rotation, position):
    return pinocchio.SE3(rotation, position).homogeneous


def test_sines_and_versines_are_those_of_numpy():
    rng = np.random.default_rng(0)
    quarters = np.arange(-40, 41) * np.pi / 2
    angles = [*quarters, *np.nextafter(quarters, 9), *rng.uniform(-8, 8, 2000), *rng.uniform(-1e4, 1e4, 2000), 1e-300]
    pairs = np.array([arm_lanes.sine_and_versine(angle) for angle in angles])
    np.testing.assert_allclose(pairs[:, 0], np.sin(angles), rtol=0, atol=6e-16)
    np.testing.assert_allclose(pairs[:, 1], 2 * np.sin(np.array(angles) / 2) ** 2, rtol=0, atol=9e-16)
    assert np.isnan(arm_lanes.sine_and_versine(np.nan)).all()


def test_frames_are_pinocchios(model, lanes):
    q = model.random_configurations(np.random.default_rng(0), LANES)
    for _ in range(2):  # in memory that has been used, too
        arm_lanes.tip_frames(model.joints, q.T.copy(), lanes)
        for lane in range(LANES):
            pose = rigid(lanes["rotation"][..., lane].copy(), lanes["position"][:, lane].copy())
            np.testing.assert_allclose(pose, model.pose(q[lane]), rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 0.99e-5, 1.01e-5, 1e-3, 0.3, 2.0, 3.1])
def test_twists_are_pinocchios(lanes, angle):
    rng = np.random.default_rng(0)
    pose = rigid(pinocchio.exp3(rng.normal(size=3)), rng.normal(size=3))
    for lane in range(LANES):
        axis = rng.normal(size=3)
        turn = pinocchio.exp3(angle * axis / np.linalg.norm(axis))
        lanes["rotation"][..., lane] = pose[:3, :3] @ turn
        lanes["position"][:, lane] = pose[:3, 3] + (angle or 1.0) * rng.normal(size=3)
    arm_lanes.pose_errors(lanes, pose)
    for lane in range(LANES):
        expected = twist_length(lanes["rotation"][..., lane].copy(), lanes["position"][:, lane].copy(), pose)
        assert arm_lanes.twist_length(lanes, lane) == pytest.approx(expected, rel=1e-9, abs=1e-14)


def test_a_lane_that_is_not_finite_leaves_the_others_alone(lanes):
    model = ArmModel("ur5")
    q = model.random_configurations(np.random.default_rng(0), LANES)
    q[3], q[5] = np.nan, np.inf
    arm_lanes.tip_frames(model.joints, q.T.copy(), lanes)
    arm_lanes.pose_errors(lanes, model.pose(q[0]))
    lengths = np.array([arm_lanes.twist_length(lanes, lane) for lane in range(LANES)])
    np.testing.assert_array_equal(np.isnan(lengths), np.isin(np.arange(LANES), (3, 5)))
    assert lengths[0] < 1e-14
