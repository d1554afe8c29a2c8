"""A joint that mimics another has no motor: beliefs and simulation move it alike, and its own limits are kept."""

import mujoco
import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.kernels import arm as kernel
from armctl.kinematics import ArmModel, ArmShapes
from armctl.kinematics.clearance import Clearance
from armctl.robot_description import load_arm
from armctl.robots.arm import build_arm_world

from .palletiser import FOLLOWS, palletiser

STEP = 1e-6


@pytest.fixture
def model(write):
    return ArmModel(load_arm(write(palletiser())))


def by_differences(function, q):
    """Return derivatives of a function of q (dof,), each a row."""
    return np.array([(function(q + d) - function(q - d)) / (2 * STEP) for d in STEP * np.eye(len(q))])


def test_the_joints_are_those_with_a_motor_and_limits_of_followers_are_kept(model):
    description = model.description
    assert description.joints == ("yaw", "shoulder", "elbow", "roll")
    np.testing.assert_allclose(description.limits.lower[2], -1.9)
    np.testing.assert_allclose(description.limits.upper[2], 2.2)
    q = np.array([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(description.all_positions(q), [0.1, 0.2, 0.3, -0.1, 0.4])
    assert any("'wrist' has no motor" in note for note in description.notes)


def test_beliefs_and_simulation_have_the_tip_at_one_place(model):
    world = build_arm_world(model.description, "position")
    data = mujoco.MjData(world)
    configurations = model.random_configurations(np.random.default_rng(0), 20)
    for q, position in zip(configurations, model.positions(configurations), strict=True):
        data.qpos[:] = model.description.all_positions(q)
        mujoco.mj_kinematics(world, data)
        np.testing.assert_allclose(data.body("arm/tip").xpos, position, atol=1e-9)
        np.testing.assert_allclose(model.position(q), position, atol=1e-9)


def test_derivatives_by_motors_are_those_by_differences(model):
    clearance = Clearance(model)
    count = len(clearance.nearest(model.home[None], 99)[0][0])
    for q in model.random_configurations(np.random.default_rng(1), 5):
        _, gradients = kernel.linearise(model.joints, q, kernel.workspace(model.joints))
        np.testing.assert_allclose(gradients, by_differences(model.position, q), atol=1e-7)
        np.testing.assert_allclose(gradients.T, model.jacobian(q)[:3], atol=1e-9)
        np.testing.assert_allclose(model.segments(q).sum(axis=0), model.position(q), atol=1e-9)
        _, slopes = clearance.nearest(q[None], count)
        measured = by_differences(lambda q: np.nan_to_num(clearance.nearest(q[None], count)[0][0], posinf=0.0), q)
        np.testing.assert_allclose(slopes[0], measured.T, atol=1e-6)


def test_no_link_moves_farther_than_the_bound_for_a_motor(model):
    """Pairs of links come nearer by at most the bounds times the motors' ways, by which edges are checked."""
    shapes, clearance = ArmShapes(model), Clearance(model)
    pairs, bounds = shapes.with_boxes(model.boxes)
    own = [tuple(pair) for pair in clearance._pairs]
    rows = [own.index(pair) for pair in map(tuple, pairs.tolist()) if pair in own]
    bounds = bounds[[i for i, pair in enumerate(map(tuple, pairs.tolist())) if pair in own]]
    rng = np.random.default_rng(2)
    for q in model.random_configurations(rng, 20):
        moved = rng.uniform(-0.1, 0.1, model.dof)
        ends = clearance.nearest(np.array([q, q + moved]), len(own))[0][:, rows]
        assert (np.abs(np.diff(ends, axis=0)[0]) <= bounds @ np.abs(moved) + 1e-9).all()


def test_physics_keeps_the_coupling_to_a_millimetre(model):
    """Behind motors that move to random places at the limits of their speeds, and at rest there."""
    description = model.description
    world = build_arm_world(description, "position")
    data, motors = mujoco.MjData(world), [0, 1, 2, 4]
    mujoco.mj_resetDataKeyframe(world, data, 0)
    errors = []
    for goal in 0.5 * model.random_configurations(np.random.default_rng(3), 3):
        for _ in range(500):
            data.ctrl[:4] = data.ctrl[4:] = np.clip(8 * (goal - data.act), -2, 2)
            mujoco.mj_step(world, data)
            mujoco.mj_kinematics(world, data)
            errors.append(np.abs(data.body("arm/tip").xpos - model.position(data.qpos[motors])).max())
    assert np.max(errors) < 1e-3
    assert max(errors[499::500]) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policy", "env"),
    [("reach_ik", "ArmReach"), ("reach_mpc", "ArmReach"), ("reach_ompl", "ArmReachObstacles")],
)
def test_experts_win_on_it(model, policy, env):
    results = armctl.evaluate(
        policy, f"armctl/{env}-v0", episodes=6, worlds=6, seed=300, env_options={"robot": model.description}
    )
    assert results.success.all()


MISTAKES = {
    "of a joint elsewhere": ({"mimic": '<mimic joint="finger"/>'}, "'wrist'.* mimics 'finger', which is no joint"),
    "of a follower": ({"elbow_mimic": '<mimic joint="shoulder"/>'}, "'elbow', which mimics another itself"),
    "of itself": ({"mimic": '<mimic joint="wrist"/>'}, "mimics 'wrist', which mimics another itself"),
    "of another kind": ({"wrist_kind": "prismatic"}, "only one of them slides"),
    "by nothing": ({"mimic": '<mimic joint="elbow" multiplier="0"/>'}, "multiplier of 0: make it fixed"),
    "by words": ({"mimic": '<mimic joint="elbow" multiplier="much"/>'}, "multiplier.*'much'"),
    "out of range": ({"wrist": (3.0, 3.1)}, "'elbow' cannot move within the limits of 'wrist'"),
    "by half, over turns": (
        {"mimic": '<mimic joint="elbow" multiplier="0.5"/>', "elbow": (-4.0, 4.0), "wrist": (-3.0, 3.0)},
        "more than a turn.*limit it to one turn",
    ),
}


@pytest.mark.parametrize(("parts", "says"), MISTAKES.values(), ids=MISTAKES)
def test_a_follower_without_a_leader_is_refused_in_a_line(write, parts, says):
    with pytest.raises(ConfigurationError, match=says):
        load_arm(write(palletiser(**parts)))


def test_followers_slow_their_leader_down(write):
    description = load_arm(write(palletiser(FOLLOWS.replace('"-1"', '"-2"'), elbow=(-1.0, 1.0), wrist=(-3.0, 3.0))))
    np.testing.assert_allclose(description.limits.velocity, [2, 2, 1, 2])
