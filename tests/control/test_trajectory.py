import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.control.streaming import CommandStream, follow
from armctl.control.trajectory import SAMPLE, JerkLimitedMotion, Trajectory, along, point_to_point, smooth
from armctl.core.errors import ConfigurationError
from armctl.robot_description import load_arm
from armctl.robot_description.joint_profiles import TICK

LIMITS = load_arm("ur5").limits
properties = settings(derandomize=True, max_examples=50)


def random_path(seed, corners):
    return np.random.default_rng(seed).uniform(-1.5, 1.5, (corners, 6))


def commanded(motion, period):
    """Positions (ticks, dof) rad of drives that are commanded to follow a motion."""
    stream = CommandStream(LIMITS, period, motion.positions[0])
    positions = [stream.position]
    for step in range(1, 2 + math.ceil(motion.duration / period)):
        position, velocity = stream.position, stream._drives
        goal = stream.goal_towards(motion.at(step * period))
        for _ in range(round(period / TICK)):
            position, velocity = follow(LIMITS, position, velocity, goal, TICK)
            positions.append(position)
    return np.array(positions)


def worst_use(trajectory):
    """Largest share of the velocity, acceleration and jerk limits that is used."""
    motion = np.vstack((trajectory.positions[:1].repeat(3, axis=0), trajectory.positions))
    used = []
    for limit in (LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk):
        motion = np.diff(motion, axis=0) / SAMPLE
        used.append((np.abs(motion) / limit).max())
    return used


def off_path(places, path):
    """Distance (rad, largest joint) of each place from the path."""
    steps = [a + share * (b - a) for a, b in itertools.pairwise(path) for share in np.linspace(0, 1, 400)]
    return np.abs(places[:, None] - np.array(steps)[None]).max(axis=-1).min(axis=1)


@properties
@given(st.integers(0, 10**6), st.integers(2, 8), st.sampled_from([0.3, 0.7, 1.0]), st.booleans())
def test_paths_are_run_within_all_limits_from_end_to_end(seed, corners, pace, stops):
    path = random_path(seed, corners)
    trajectory = along(LIMITS, path, pace, stops)
    np.testing.assert_allclose(trajectory.positions[[0, -1]], path[[0, -1]], atol=1e-9)
    assert max(worst_use(trajectory)) <= 1 + 1e-6


@properties
@given(st.integers(0, 10**6), st.booleans())
def test_point_to_point_keeps_the_limits_and_is_as_soon_as_the_slowest_joint_can_be(seed, straight):
    start, goal = random_path(seed, 2)
    trajectory = point_to_point(LIMITS, start, goal, straight)
    np.testing.assert_allclose(trajectory.positions[[0, -1]], [start, goal], atol=1e-9)
    assert max(worst_use(trajectory)[:2]) <= 1 + 1e-6
    alone = []
    for joint in range(6):
        only = start.copy()
        only[joint] = goal[joint]
        alone.append(point_to_point(LIMITS, start, only).duration)
    assert trajectory.duration >= max(alone) - 2 * SAMPLE
    if not straight:
        assert trajectory.duration <= max(alone) + 2 * SAMPLE
    if straight:
        share = (trajectory.positions - start) @ (goal - start) / np.sum((goal - start) ** 2)
        np.testing.assert_allclose(trajectory.positions, start + share[:, None] * (goal - start), atol=1e-6)


def motion_to(goals, velocities=None):
    """Positions, velocities and accelerations (3, steps, 6) of a motion that is planned anew to each goal."""
    motion, states = JerkLimitedMotion(LIMITS, 0.04, np.zeros(6)), []
    for step, goal in enumerate(goals):
        motion.step(goal, None if velocities is None else velocities[step])
        states.append((motion.position, motion.velocity, motion.acceleration))
    return np.array(states).swapaxes(0, 1)


@properties
@given(st.integers(0, 10**6), st.booleans())
def test_a_motion_planned_anew_keeps_all_limits_whatever_its_goals(seed, moving):
    rng = np.random.default_rng(seed)
    goals = rng.uniform(-2, 2, (4, 6)).repeat(8, axis=0) + rng.normal(0, 0.1, (32, 6))
    _, speeds, accelerations = motion_to(goals, rng.uniform(-4, 4, (32, 6)) if moving else None)
    assert (np.abs(speeds) <= LIMITS.velocity + 1e-6).all()
    assert (np.abs(accelerations) <= LIMITS.acceleration + 1e-6).all()
    assert (np.abs(np.diff(accelerations, axis=0)) <= 0.04 * LIMITS.jerk + 1e-6).all()


def test_a_motion_planned_anew_is_the_minimum_time_motion_if_the_goal_stays():
    goal = np.array([1.5, -0.8, 0.4, 0.2, -0.1, 0.05])
    positions, *_ = motion_to(np.tile(goal, (30, 1)))
    for joint in range(6):
        only = np.zeros(6)
        only[joint] = goal[joint]
        expected = point_to_point(LIMITS, np.zeros(6), only).at(0.04 * np.arange(1, 31))[:, joint]
        np.testing.assert_allclose(positions[:, joint], expected, atol=1e-3)
    preview = JerkLimitedMotion(LIMITS, 0.04, np.zeros(6)).preview(goal, 0.04)
    np.testing.assert_allclose(preview[1:], positions[: len(preview) - 1], atol=1e-6)


def test_a_moving_goal_is_reached_at_its_velocity():
    times = 0.04 * np.arange(1, 61)[:, None]
    velocity = np.linspace(-0.9, 0.9, 6)
    positions, speeds, _ = motion_to(0.3 + times * velocity, np.tile(velocity, (60, 1)))
    np.testing.assert_allclose(positions[30:], (0.3 + times * velocity)[30:], atol=1e-6)
    np.testing.assert_allclose(speeds[30:], np.tile(velocity, (30, 1)), atol=1e-6)


@pytest.mark.one_case
@pytest.mark.parametrize("seed", range(5))
def test_corners_are_cut_the_less_the_slower_and_not_at_all_with_stops(seed):
    path = random_path(seed, 4)
    cuts = [off_path(along(LIMITS, path, pace).positions[::5], path).max() for pace in (1.0, 0.5, 0.25)]
    assert cuts[0] > cuts[1] > cuts[2] > 0
    assert off_path(along(LIMITS, path, stops=True).positions[::5], path).max() < 5e-3
    assert along(LIMITS, path).duration < along(LIMITS, path, stops=True).duration


def test_the_quickest_free_trajectory_is_taken():
    path = random_path(0, 4)
    tried = []

    def is_free(trajectory):
        tried.append(trajectory.duration)
        return len(tried) == 2

    assert smooth(LIMITS, path, is_free).duration == tried[1]
    assert tried[0] < tried[1]
    stopping = smooth(LIMITS, path, lambda trajectory: False)
    assert off_path(stopping.positions[::5], path).max() < 5e-3


def test_times_before_and_after_are_at_rest():
    trajectory = point_to_point(LIMITS, np.zeros(6), np.ones(6))
    np.testing.assert_allclose(trajectory.at([-1.0, 0.0]), np.zeros((2, 6)), atol=1e-12)
    np.testing.assert_allclose(trajectory.at([trajectory.duration, 99.0]), np.ones((2, 6)), atol=1e-9)
    between = trajectory.at(np.linspace(0, trajectory.duration, 1000))
    assert (np.diff(between, axis=0) >= -1e-12).all()


def test_standing_still_is_a_trajectory():
    assert Trajectory(np.zeros((1, 6))).duration == 0.0
    assert point_to_point(LIMITS, np.ones(6), np.ones(6)).duration <= SAMPLE
    np.testing.assert_allclose(along(LIMITS, np.ones((3, 6))).positions, 1.0)


@pytest.mark.parametrize("seed", range(4))
def test_drives_follow_with_the_headroom_they_need(seed):
    path = random_path(seed, 4)
    trajectory = along(replace(LIMITS, acceleration=0.7 * LIMITS.acceleration), path)
    places = commanded(trajectory, 0.04)
    at_decisions = places[::5]
    wanted = trajectory.at(0.04 * np.arange(len(at_decisions)))
    assert np.abs(at_decisions - wanted).max() < 0.02
    np.testing.assert_allclose(places[-1], path[-1], atol=2e-3)


@pytest.mark.parametrize(
    "path", [np.zeros((1, 6)), np.zeros((3, 5)), np.zeros(6), np.full((2, 6), 9.0), np.full((2, 6), np.nan)]
)
def test_unusable_paths_are_refused(path):
    with pytest.raises(ConfigurationError, match="path"):
        along(LIMITS, path)
