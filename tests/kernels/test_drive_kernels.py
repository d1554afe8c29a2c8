"""Each kernel of paths, bridges and their controller computes what its reference in NumPy does."""

from typing import Any

import numpy as np
import pytest

from armctl.control.arc_path import ArcPath
from armctl.control.drive_nlp import DriveMpcOptions
from armctl.kernels import arc_path
from armctl.kernels import drive_mpc as kernel
from armctl.scene import BridgeMap

from . import drive_reference as reference

CLOSE: dict[str, Any] = {"rtol": 0, "atol": 1e-12}
OPTIONS, SMOOTHING = DriveMpcOptions(), kernel.SMOOTHING
NUMBERS = np.array(tuple(getattr(OPTIONS, name) for name in kernel.NAMES), kernel.OPTIONS)[()]
STEPS = OPTIONS.steps


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def paths(rng, count):
    """Random polylines: the reference, and the segments that kernels take."""
    for corners in rng.integers(2, 9, count):
        points = np.cumsum(rng.normal(size=(corners, 2)), axis=0)
        yield reference.Path(points), ArcPath(points).segments


def test_paths(rng):
    for path, segments in paths(rng, 30):
        length = path.arc[-1]
        arcs, points = rng.uniform(-1, length + 1, 80), rng.normal(size=(40, 2))
        arcs[:3] = 0.0, length, path.arc[1]
        found, nearest = np.empty((80, 2)), np.empty(40)
        arc_path.points_at(segments, arcs, found)
        np.testing.assert_allclose(found, path.points_at(arcs), **CLOSE)
        for low, high in ((-0.5, length), (0.3, 0.3), (0.2, 1.0)):
            arc_path.nearest(segments, points, low, high, 0.025, nearest)
            np.testing.assert_allclose(nearest, path.nearest(points, low, high, 0.025), **CLOSE)
        rows = np.empty((80, 4))
        kernel.follow_path(segments, arcs, rows)
        np.testing.assert_allclose(rows, np.hstack(path.rounded(arcs, SMOOTHING)), **CLOSE)


def bridge(rng, blocks):
    sizes = rng.uniform(0.1, 0.8, (blocks, 2))
    centres = rng.uniform((0, -2), (12, 2), (blocks, 2))
    return BridgeMap(12.0, 2.0, np.column_stack((centres, rng.uniform(-3, 3, blocks), sizes)))


@pytest.mark.parametrize("blocks", [0, 1, 6])
def test_obstacles_and_people(rng, blocks):
    deck, points, away = bridge(rng, blocks), rng.uniform((0, -2), (12, 2), (300, 2)), kernel.NOWHERE
    points[:blocks] = deck.blocks[:, :2]
    obstacles = deck.nearest(points)
    np.testing.assert_allclose(obstacles, reference.nearest_on_bridge(deck, points), **CLOSE)
    planes, people, chosen = np.empty((300, 4, 3)), rng.normal(size=(300, blocks, 2)), np.empty((300, 3, 2))
    inside = (np.linalg.norm(obstacles - points[:, None], axis=-1) < 1e-3).any(axis=1)
    refuge = rng.normal(size=(300, 4))
    expected = np.where(inside[:, None], refuge[:, :2], points)
    assert kernel.leave_obstacles(points, obstacles, refuge) == inside.any() == (blocks > 0)
    np.testing.assert_array_equal(points, expected)
    obstacles = deck.nearest(points)
    kernel.separate(points, obstacles, planes)
    np.testing.assert_allclose(planes, reference.planes(4, obstacles, points, away), rtol=1e-12, atol=1e-12)
    kernel.choose_people(points, people, chosen)
    np.testing.assert_array_equal(chosen, reference.closest(3, people, points, away))


@pytest.mark.parametrize(("blocks", "walkers"), [(0, 0), (3, 2)])
def test_drives(rng, blocks, walkers):
    speeds, offsets = np.array((2.0, 1.0, 0.0)), np.array((0.0, -0.7, 0.7))
    points, costs = np.empty((3, 3, STEPS + 2, 2)), np.empty((3, 3))
    for path, segments in paths(rng, 20):
        start = np.concatenate((path.points[0] + rng.normal(size=2), rng.uniform(-9, 9, 1), rng.uniform(-0.5, 2, 2)))
        progress, deck = rng.uniform(0, 1), bridge(rng, blocks)
        kernel.drive_beside(NUMBERS, segments, start, progress, speeds, offsets, points, costs)
        places, speed, ahead, expected = reference.drives(
            OPTIONS, path, SMOOTHING, start, progress, speeds, offsets, kernel.SIDESTEP
        )
        drives, prices = points.reshape(9, -1, 2), costs.reshape(-1)
        np.testing.assert_allclose(drives[:, :-1], places, **CLOSE)
        np.testing.assert_allclose(prices, expected, rtol=1e-12, atol=1e-11)

        people = rng.uniform((0, -2), (8, 2), (STEPS + 1, walkers, 2))
        obstacles = deck.nearest(points.reshape(-1, 2)).reshape(9, STEPS + 2, -1, 2)
        kernel.intrude(NUMBERS, drives, obstacles, people, prices)
        expected += OPTIONS.intrusion * reference.intrusions(OPTIONS, places, obstacles[:, :-1], people)
        np.testing.assert_allclose(prices, expected, rtol=1e-12, atol=1e-10)

        knots = np.full((STEPS + 1, 8), np.nan)
        for drive in range(6):  # those that stand have no direction in which they move
            kernel.drive_through(NUMBERS, start, speeds[drive // 3], drives[drive], knots)
            expected_states = reference.states(OPTIONS, start, places[drive], speed[drive], ahead[drive])
            np.testing.assert_allclose(knots[:, :5], expected_states, rtol=0, atol=1e-9)  # short steps magnify
            assert not knots[:, 5:].any()


def test_plans_go_on(rng):
    for _ in range(30):
        plan, start, knots = rng.normal(size=(STEPS + 1, 8)), rng.normal(size=5) * 9, np.empty((STEPS + 1, 8))
        kernel.shift(start, plan, OPTIONS.period, knots)
        np.testing.assert_allclose(knots, reference.shifted(start, plan, OPTIONS.period), **CLOSE)
        expected = np.linalg.norm(plan[:, :2] - knots[:, :2], axis=1).max()
        assert kernel.farthest_apart(plan, knots) == pytest.approx(expected, abs=1e-12)
