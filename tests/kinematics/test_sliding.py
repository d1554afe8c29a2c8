"""An arm on a linear axis, and one with a telescope: joints that slide are in all that controllers compute."""

import mujoco
import numpy as np
import pinocchio
import pytest

from armctl.core.errors import ConfigurationError
from armctl.kernels import arm as kernel
from armctl.kinematics import ArmModel, Ik
from armctl.kinematics.clearance import Clearance
from armctl.kinematics.closed_forms import six_joints
from armctl.kinematics.edge_checker import ArmShapes
from armctl.robot_description import load_arm
from armctl.robots import build_arm_world
from armctl.rollout import evaluate

from ..robot_description.sliding_arms import gantry, telescope


@pytest.fixture(params=[gantry, telescope], ids=["gantry", "telescope"])
def model(request, tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(request.param())
    return ArmModel(load_arm(path))


def test_kernels_pinocchio_and_mujoco_agree(model):
    assert len(model.description.sliding) == 1
    world = build_arm_world(model.description, "position")
    data = mujoco.MjData(world)
    for q in model.random_configurations(np.random.default_rng(0), 30):
        data.qpos[:] = q
        mujoco.mj_kinematics(world, data)
        np.testing.assert_allclose(model.positions(q), model.position(q), atol=1e-12)
        np.testing.assert_allclose(data.body("arm/tool").xpos, model.position(q), atol=1e-12)
        gradients = kernel.linearise(model.joints, q, kernel.workspace(model.joints))[1]
        np.testing.assert_allclose(gradients.T, model.jacobian(q)[:3], atol=1e-12)


def test_gradients_of_distances_are_finite_differences(model):
    clearance = Clearance(model)
    step = 1e-6
    for q in model.random_configurations(np.random.default_rng(1), 20):
        neighbours = np.vstack([q, q + step * np.eye(model.dof)])
        distances, gradients = clearance.nearest(neighbours, 3)
        changes = (distances[1:] - distances[0]) / step
        usable = np.isfinite(distances[0]) & (distances > 0.02).all(axis=0)
        np.testing.assert_allclose(changes.T[usable], gradients[0][usable], atol=1e-3)


def test_no_point_of_a_link_moves_farther_than_bounds_of_edges_say(model):
    shapes, rng = ArmShapes(model), np.random.default_rng(2)
    starts, goals = model.random_configurations(rng, 200), model.random_configurations(rng, 200)
    ends = [np.array([model_ends(model, q) for q in both]) for both in (starts, goals)]
    moved = np.linalg.norm(ends[1] - ends[0], axis=-1).max(axis=-1)
    assert (moved <= np.abs(goals - starts) @ shapes._radii.T + 1e-9).all()
    far = np.linalg.norm(ends[0] - model.shoulder, axis=-1).max(axis=-1)
    assert (far[:, model.links["joint"] > 0] <= shapes._reach[model.links["joint"] > 0] + 1e-9).all()


def model_ends(model, q):
    """Return the ends (links, 2, 3) of the capsules' segments."""
    placements = model.pinocchio.createData()
    pinocchio.forwardKinematics(model.pinocchio, placements, q)
    return np.array([
        [placements.oMi[int(link["joint"])].act(link[end]) for end in ("start", "end")] for link in model.links
    ])  # fmt: skip


def test_closed_forms_and_networks_leave_such_arms_alone(model):
    assert six_joints(model) is None
    assert Ik(model).position(model.position(model.home)).reachable
    with pytest.raises(ConfigurationError, match="slides"):
        model.geometry()


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["reach_ik", "reach_mpc", "reach_ruckig"])
def test_experts_reach_with_them(model, policy):
    results = evaluate(
        policy, "armctl/ArmReach-v0", episodes=6, seed=0, worlds=6, env_options={"robot": model.description},
        lower_bound_steps=False,
    )  # fmt: skip
    assert results.success.all()
