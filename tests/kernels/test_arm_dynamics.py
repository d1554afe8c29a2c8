"""Dynamics of arms: the equations of motion against Pinocchio, and joints behind their drives against MuJoCo."""

import numpy as np
import pinocchio
import pytest

from armctl.envs import make_worlds
from armctl.kernels import braking
from armctl.kernels.arm_dynamics import compute_equations, equations_of, joints_of, place_joints
from armctl.kinematics import ArmModel
from armctl.kinematics.records import body_records
from armctl.policies.robot_filters import ArmFilterOptions, ArmFilters


@pytest.mark.parametrize("robot", ["ur5", "ur10"])
def test_equations_are_those_of_pinocchio(robot):
    arm, rng = ArmModel(robot), np.random.default_rng(0)
    model, data = arm.pinocchio, arm.pinocchio.createData()
    bodies = body_records(model, arm.description, np.ones(arm.dof), np.ones(arm.dof))
    state, equations = joints_of(arm.dof), equations_of(arm.dof)
    for _ in range(10):
        state.q[:], state.velocity[:] = rng.uniform(-3, 3, (2, arm.dof))
        place_joints(arm.joints, state)
        compute_equations(arm.joints, bodies, state, equations)
        upper = np.triu(pinocchio.crba(model, data, state.q))
        weight = np.array(pinocchio.computeGeneralizedGravity(model, data, state.q))
        bias = pinocchio.nonLinearEffects(model, data, state.q, state.velocity) - weight
        np.testing.assert_allclose(equations.mass, upper + np.triu(upper, 1).T, atol=1e-12)
        np.testing.assert_allclose(equations.weight, weight, atol=1e-12)
        np.testing.assert_allclose(equations.bias, bias, atol=1e-12)


def test_joints_follow_their_drives_as_in_mujoco():
    """Within 0.5 mrad until they rest or touch something, where motors are at the limits of their torque as well.

    They brake at once, which is not the back-up of each action: some are safe only if they are held before.
    """
    n = 8
    worlds, rng = make_worlds("armctl/ArmReach-v0", n), np.random.default_rng(0)
    task, filters, saturated = worlds.task, ArmFilters(worlds.task, ArmFilterOptions()), 0
    worlds.reset(seed=0)
    filters.reset(np.arange(n, dtype=np.int32))
    for _ in range(3):
        for _ in range(8):
            worlds.step(safe_actions(filters, rng.uniform(-3, 3, (n, 6))))
        actions = safe_actions(filters, rng.uniform(-3, 3, (n, 6)))
        rollouts, touched = [rollout_of(filters, i) for i in range(n)], np.zeros(n, dtype=bool)
        for _ in range(8):
            worlds.step(actions)
            touched |= task.simulation.array("qfrc_constraint").any(axis=1)
            saturated += int((np.abs(task.simulation.array("qfrc_actuator")) > 149).sum())
            for i, (arm, memory) in enumerate(rollouts):
                for _ in range(arm.ticks):
                    braking.advance(arm, actions[i], memory)
                if not touched[i]:
                    np.testing.assert_allclose(memory.joints.q, task.arm.joint_positions[i], atol=5e-4)
                braking.brake_commands(arm, memory.position, memory.speeds, actions[i])
        assert touched.sum() <= 1
    assert saturated > 0


def safe_actions(filters, actions):
    return np.array([filters.act(i, *values) for i, values in enumerate(zip(actions, filters.states(), strict=True))])


def rollout_of(filters, world):
    arm, state = filters.filters[world].arm, braking.ArmState(*filters.states()[world].reshape(4, -1))
    memory = braking.memory_of(arm)
    braking.start(arm, state, np.full(len(arm.scene.pairs), 9.0), memory)
    return arm, memory
