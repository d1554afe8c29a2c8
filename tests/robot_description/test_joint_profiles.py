from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from ..kernels import joint_profiles

properties = settings(derandomize=True, max_examples=200)
batches = settings(derandomize=True, max_examples=10)
LIMITS = SimpleNamespace(
    lower=np.array([-6.0, -3.0, -1.0]),
    upper=np.array([6.0, 2.0, 1.5]),
    velocity=np.array([3.0, 1.0, 2.0]),
    acceleration=np.array([15.0, 4.0, 40.0]),
)
parts = hnp.arrays(float, 3, elements=st.floats(0, 1, allow_subnormal=False))


many = hnp.arrays(float, (20, 3), elements=st.floats(0, 1, allow_subnormal=False), fill=st.nothing())
"""As many at once: a step takes as long for twenty as for one."""


def between(part):
    return LIMITS.lower + part * (LIMITS.upper - LIMITS.lower)


def run(goal, position, velocity, ticks):
    """Positions and velocities, (ticks + 1, 3), on the way to a goal."""
    positions, velocities = [position], [velocity]
    for _ in range(ticks):
        wanted = joint_profiles.towards(goal, positions[-1], LIMITS)
        velocities.append(joint_profiles.limited(wanted, positions[-1], velocities[-1], LIMITS))
        positions.append(positions[-1] + velocities[-1] * joint_profiles.TICK)
    return np.array(positions), np.array(velocities)


@pytest.mark.slow
@batches
@given(many, many)
def test_arrive_and_stand_still_exactly_there(a, b):
    start, goal = between(a), between(b)
    positions, velocities = run(goal, start, np.zeros((20, 3)), 1000)
    np.testing.assert_allclose(positions[-1], goal, atol=1e-9)
    np.testing.assert_allclose(velocities[-1], 0, atol=1e-9)
    low, high = np.minimum(start, goal), np.maximum(start, goal)
    assert (positions >= low - 1e-9).all()
    assert (positions <= high + 1e-9).all()


@pytest.mark.slow
@properties
@given(parts, st.lists(parts, min_size=1, max_size=8), st.integers(1, 40))
def test_keep_to_all_limits_whatever_is_wanted(a, goals, ticks):
    position, velocity = between(a), np.zeros(3)
    for goal in goals:
        positions, velocities = run(between(goal), position, velocity, ticks)
        assert (np.abs(velocities) <= LIMITS.velocity + 1e-12).all()
        assert (np.abs(np.diff(velocities, axis=0)) <= LIMITS.acceleration * joint_profiles.TICK + 1e-12).all()
        assert (positions >= LIMITS.lower - 1e-9).all()
        assert (positions <= LIMITS.upper + 1e-9).all()
        position, velocity = positions[-1], velocities[-1]


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_wanting_to_leave_the_range_ends_at_its_border(direction):
    position = velocity = np.zeros(3)
    for _ in range(2000):
        velocity = joint_profiles.limited(np.full(3, 1e6 * direction), position, velocity, LIMITS)
        position = position + velocity * joint_profiles.TICK
    np.testing.assert_allclose(position, LIMITS.upper if direction > 0 else LIMITS.lower, atol=1e-9)


@properties
@given(parts, parts, hnp.arrays(float, 3, elements=st.floats(-1, 1, allow_subnormal=False)))
def test_travel_time_is_when_the_extent_gets_there(a, b, share):
    way, velocity = between(a) - between(b), share * LIMITS.velocity
    times = joint_profiles.travel_time(way, velocity, LIMITS)
    reach, speed = joint_profiles.max_displacement(times, np.where(way < 0, -velocity, velocity), LIMITS)
    np.testing.assert_allclose(reach, np.abs(way), atol=1e-9)
    assert (np.abs(speed) <= LIMITS.velocity + 1e-12).all()


@pytest.mark.slow
@batches
@given(many, many)
def test_no_drive_is_sooner_than_the_travel_time_but_by_half_a_tick(a, b):
    start, goal = between(a), between(b)
    positions, _ = run(start + 10 * (goal - start), start, np.zeros((20, 3)), 1000)
    times = joint_profiles.travel_time(goal - start, 0.0, LIMITS)
    there = np.abs(positions - start) >= np.abs(goal - start) - 1e-9
    arrived = np.where(there.any(axis=0), there.argmax(axis=0) * joint_profiles.TICK, np.inf)
    assert (arrived >= times - joint_profiles.TICK / 2 - 1e-9).all()


@properties
@given(parts, parts)
def test_progress_starts_and_ends_at_rest_within_the_limits(a, b):
    ways = between(a) - between(b)
    clock = np.linspace(0, 20, 4001)[:, None]
    moved = joint_profiles.trapezoidal_displacement(clock, ways, LIMITS)
    speed = np.diff(moved, axis=0) / 0.005
    np.testing.assert_array_equal(moved[0], 0)
    np.testing.assert_allclose(moved[-1], ways, atol=1e-9)
    assert (np.abs(speed) <= LIMITS.velocity + 1e-9).all()
    assert (np.abs(np.diff(speed, axis=0)) / 0.005 <= LIMITS.acceleration * (1 + 1e-6) + 1e-6).all()


@properties
@given(parts, parts)
def test_a_goal_to_pass_lets_all_joints_be_there_in_time(a, b):
    start, place = 0.4 * between(a), 0.4 * between(b)
    time = float(joint_profiles.travel_time(place - start, 0.0, LIMITS).max())
    goal = joint_profiles.fly_by_setpoint(start, place, time, LIMITS)
    unclipped = (goal > LIMITS.lower) & (goal < LIMITS.upper)
    moved = joint_profiles.trapezoidal_displacement(np.array([time]), goal - start, LIMITS)
    assert (np.abs(moved) >= np.abs(place - start) - 1e-6)[unclipped].all()
    assert ((goal - start) * (place - start) >= 0).all()
