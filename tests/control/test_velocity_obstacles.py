"""Velocity obstacles against their definition, and the best velocity against a solver of quadratic programmes."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from armctl.control.velocity_obstacles import avoidance, nearest_velocity

HORIZON, PERIOD = 2.0, 0.1
coordinates = st.floats(-3, 3).map(lambda number: round(number, 3))


def gap(position, velocity, radius, until):
    """Least distance (m) between two discs whose relative velocity stays as it is, until a time."""
    times = np.linspace(0, until, 2001)[:, None]
    return np.linalg.norm(position - times * velocity, axis=1).min() - radius


@settings(max_examples=100, deadline=None)
@given(coordinates, coordinates, coordinates, coordinates, st.floats(0.2, 0.8))
def test_the_changed_velocity_just_touches(x, y, vx, vy, radius):
    position, velocity = np.array((x, y)), np.array((vx, vy))
    if np.linalg.norm(position) < radius + 0.05:
        return
    change, normal = avoidance(position, velocity, radius, HORIZON, PERIOD)
    assert np.linalg.norm(normal) == pytest.approx(1)
    assert gap(position, velocity + change, radius, HORIZON) == pytest.approx(0, abs=0.02)
    collides = gap(position, velocity, radius, HORIZON) < -0.01
    assert (change @ normal > 0) >= collides


def test_overlapping_discs_part_within_a_period():
    position = np.array((0.3, 0.0))
    change, _ = avoidance(position, np.zeros(2), 0.5, HORIZON, PERIOD)
    assert np.linalg.norm(position - PERIOD * change) == pytest.approx(0.5)
    assert np.isfinite(avoidance(np.zeros(2), np.zeros(2), 0.5, HORIZON, PERIOD)).all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_best_velocity_is_that_of_a_quadratic_programme(seed):
    rng = np.random.default_rng(seed)
    angles, preferred = rng.uniform(0, 2 * np.pi, 6), rng.uniform(-2, 2, 2)
    normals, bounds = np.column_stack((np.cos(angles), np.sin(angles))), -rng.uniform(0, 1, 6)
    best = nearest_velocity(preferred, normals, bounds, np.zeros(6, dtype=bool))

    def distance(velocity):
        return float(((velocity - preferred) ** 2).sum())

    kept: Any = {"type": "ineq", "fun": lambda v: normals @ v - bounds}
    solve: Any = minimize
    expected = solve(distance, np.zeros(2), constraints=[kept], method="SLSQP", tol=1e-12)
    np.testing.assert_allclose(best, expected.x, atol=1e-3)


def test_only_soft_half_planes_give_way():
    normals, bounds = np.array([(1.0, 0.0), (-1.0, 0.0)]), np.array([0.5, 0.0])
    best = nearest_velocity((1.0, 0.2), normals, bounds, np.array([True, False]))
    assert -1e-6 <= best[0] <= 1e-6
    assert best[1] == pytest.approx(0.2)


def test_two_who_take_half_each_pass_each_other():
    positions, goals = np.array([(-2.0, 0.01), (2.0, -0.01)]), np.array([(1.0, 0.0), (-1.0, 0.0)])
    velocities, distances = goals.copy(), []
    for _ in range(60):
        chosen = []
        for me, other in ((0, 1), (1, 0)):
            relative = velocities[me] - velocities[other]
            change, normal = avoidance(positions[other] - positions[me], relative, 0.6, HORIZON, PERIOD)
            bound = normal @ (velocities[me] + change / 2)
            chosen.append(nearest_velocity(goals[me], normal[None], np.array([bound]), np.array([True])))
        velocities = np.array(chosen)
        positions = positions + PERIOD * velocities
        distances.append(np.linalg.norm(positions[0] - positions[1]))
    assert np.min(distances) > 0.59
    assert positions[0, 0] > 1
    assert positions[1, 0] < -1
