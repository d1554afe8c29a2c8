import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.control.reach_problem import OcpParameters, ReachProblem, straight_to
from armctl.control.streaming import CommandStream, command_for, follow
from armctl.control.trajectory import JerkLimitedMotion
from armctl.robot_description import JointLimits, load_arm

from ..kernels.joint_profiles import TICK, limited, towards

LIMITS = load_arm("ur5").limits
PERIOD = 0.04
rates = st.lists(st.floats(-1, 1), min_size=6, max_size=6).map(np.array)


def test_follow_is_the_law_of_the_drives_tick_by_tick():
    position, velocity, goal = np.zeros(6), np.full(6, 0.3), np.linspace(-1, 1, 6)
    expected, speed = position, velocity
    for _ in range(5):
        speed = limited(towards(goal, expected, LIMITS), expected, speed, LIMITS)
        expected = expected + speed * TICK
    found = follow(LIMITS, position, velocity, goal, PERIOD)
    np.testing.assert_allclose(found, (expected, speed), rtol=0, atol=1e-12)


@settings(max_examples=200)
@given(rates, rates, rates, st.floats(0.0, 1.0))
def test_the_command_leads_where_some_command_would(place, speed, way, near):
    velocity = speed * LIMITS.velocity
    room = (velocity**2 / (2 * LIMITS.acceleration) + np.abs(velocity) * TICK) * np.sign(velocity)
    position = np.clip(place * near * np.pi, LIMITS.lower - np.minimum(room, 0), LIMITS.upper - np.maximum(room, 0))
    goal = np.clip(position + 0.2 * way, LIMITS.lower, LIMITS.upper)
    there = follow(LIMITS, position, velocity, goal, PERIOD)[0]
    found = command_for(LIMITS, position, velocity, there - position, PERIOD)
    assert (found >= LIMITS.lower).all()
    assert (found <= LIMITS.upper).all()
    ended = follow(LIMITS, position, velocity, found, PERIOD)[0]
    np.testing.assert_allclose(ended, there, atol=3e-4)  # rad


def test_what_cannot_be_done_is_done_as_far_as_it_goes():
    position, velocity = np.zeros(6), np.zeros(6)
    for sign in (-1, 1):
        goal = command_for(LIMITS, position, velocity, np.full(6, sign * 1.0), PERIOD)
        ended = follow(LIMITS, position, velocity, goal, PERIOD)[0]
        farthest = follow(LIMITS, position, velocity, np.full(6, sign * 3.0), PERIOD)[0]
        np.testing.assert_allclose(ended, farthest)


def test_drives_do_a_plan_and_keep_their_limits():
    problem = ReachProblem(horizon=40)
    stream, goal = CommandStream(LIMITS, PERIOD, np.zeros(6)), np.array([1.0, -0.8, 0.6, -0.4, 0.2, 0.0])
    position, velocity, off = np.zeros(6), np.zeros(6), []
    for _ in range(40):
        situation = OcpParameters(stream.position, stream.velocity, np.zeros((40, 3)), None)
        motion = straight_to(problem, LIMITS, situation, goal)
        command = stream.goal(motion)
        for _ in range(5):
            before = velocity
            velocity = limited(towards(command, position, LIMITS), position, velocity, LIMITS)
            position = position + velocity * TICK
            assert (np.abs(velocity) <= LIMITS.velocity + 1e-9).all()
            assert (np.abs(velocity - before) <= LIMITS.acceleration * TICK + 1e-9).all()
        np.testing.assert_allclose(position, stream.position, atol=1e-12)  # it knows without being told
        off.append(np.abs(position - motion.positions[1]).max())
    assert max(off) < 0.01  # rad: a sudden start of the plan is for drives to catch up with
    np.testing.assert_allclose(position, goal, atol=1e-4)


def test_a_command_keeps_to_a_smooth_way():
    times = np.arange(1, 120) * PERIOD
    way = 0.5 * (1 - np.cos(times))[:, None] * np.linspace(-1, 1, 6)
    position, velocity = np.zeros(6), np.zeros(6)
    for wanted in way:
        goal = command_for(LIMITS, position, velocity, wanted - position, PERIOD)
        position, velocity = follow(LIMITS, position, velocity, goal, PERIOD)
        np.testing.assert_allclose(position, wanted, atol=3e-4)


@pytest.mark.parametrize("dof", [1, 7])
def test_other_numbers_of_joints(dof):
    limits = JointLimits(*(np.full(dof, value) for value in (-2.0, 2.0, 3.0, 100.0, 15.0, 300.0)))
    goal = command_for(limits, np.zeros(dof), np.zeros(dof), np.full(dof, 0.01), PERIOD)
    np.testing.assert_allclose(follow(limits, np.zeros(dof), np.zeros(dof), goal, PERIOD)[0], 0.01, atol=1e-4)


@pytest.mark.parametrize(("by_velocity", "error"), [(True, 0.008), (False, 0.03)])  # rad
def test_drives_follow_a_jerk_limited_motion_at_its_full_acceleration(by_velocity, error):
    motion, stream = JerkLimitedMotion(LIMITS, PERIOD, np.zeros(6)), CommandStream(LIMITS, PERIOD, np.zeros(6))
    position, velocity, goal = np.zeros(6), np.zeros(6), np.array([1.5, -0.8, 0.4, 0.2, -0.1, 0.05])
    for _ in range(40):
        motion.step(goal)
        state = motion.position, motion.velocity
        command = stream.velocity_through(*state) if by_velocity else stream.goal_through(*state)
        for _ in range(5):
            wanted = command if by_velocity else towards(command, position, LIMITS)
            velocity = limited(wanted, position, velocity, LIMITS)
            position = position + velocity * TICK
        np.testing.assert_allclose(stream.position, position, atol=1e-9)  # it knows where the drives are
        assert np.abs(position - motion.position).max() < error
    np.testing.assert_allclose(position, goal, atol=1e-4)
