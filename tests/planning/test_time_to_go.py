import dataclasses

import numpy as np
import pytest

from armctl.planning import Lattice, SpaceTime
from armctl.scene import BridgeMap, PedestrianTrajectories
from armctl.tasks.bridge.layout import sample_layout

LENGTH, HALF_WIDTH, GOAL, CLEARANCE = 8.0, 1.0, 7.0, 0.3
GAP = np.array([[4.0, 0.75, 0.0, 0.3, 0.25], [4.0, -0.75, 0.0, 0.3, 0.25]])
"""A wall, but for a gap of 1 m in the middle."""
SPACE_TIME = SpaceTime(Lattice(LENGTH, HALF_WIDTH), horizon=12.0)


def bridge(*people, blocks=GAP):
    """People are start, end, speed, and the distance walked at time 0."""
    start, end = (np.array([one[k] for one in people], float).reshape(-1, 2) for k in (0, 1))
    speed, phase = (np.array([one[k] for one in people], float) for k in (2, 3))
    return BridgeMap(LENGTH, HALF_WIDTH, blocks, PedestrianTrajectories(start, end, speed, phase, 0.25))


def to_go(found, points, times):
    points, times = np.broadcast_arrays(np.array(points, float), np.asarray(times, float)[..., None])
    points, times = points.reshape(-1, 2), times[..., 0].ravel()
    bridges = np.zeros(len(points), dtype=int)
    return SPACE_TIME.interpolate(found.unhindered[None], found.extra[None], bridges, points, times)


def test_without_people_it_is_the_path_over_the_speed():
    rng = np.random.default_rng(0)
    for _ in range(3):
        one = sample_layout(rng, 12.0, 4.0, 4, 0, 1).map
        space_time = SpaceTime(Lattice(one.length, one.half_width), speed=2.0, horizon=5.0)
        found = space_time.times(one, 11.0, 0.36)
        lengths = space_time.lattice.lengths(one, 11.0, 0.36)
        np.testing.assert_allclose(found.unhindered, lengths / 2.0, atol=1e-9)
        np.testing.assert_allclose(found.extra, 0.0, atol=1e-4)


def test_a_person_who_stands_aside_costs_nothing_and_never_saves_time():
    aside = SPACE_TIME.times(bridge(((1.0, 0.9), (1.0, 0.9), 0.0, 0.0)), GOAL, CLEARANCE)
    assert to_go(aside, [[3.0, 0.0]], 0.0) == pytest.approx(4.0 / 1.6, rel=0.03)
    rng = np.random.default_rng(1)
    for _ in range(3):
        people = sample_layout(rng, 14.0, 4.0, 2, 3, 1).map
        space_time = SpaceTime(Lattice(people.length, people.half_width), horizon=8.0)
        extra = space_time.times(people, 13.0, CLEARANCE).extra
        assert extra.min() > -1e-4
        assert extra.max() > 0.5


def test_who_stands_before_a_gap_waits_while_somebody_comes_through_it():
    """He walks through the gap for 4 s, and then on to where he is in nobody's way."""
    walker = ((4.8, 0.0), (0.0, 0.0), 0.3, 0.0)  # leaves the gap towards the rover: then he is at x = 3
    found = SPACE_TIME.times(bridge(walker), GOAL, CLEARANCE)
    times = np.linspace(0.0, 3.0, 13)
    ahead = to_go(found, [3.2, -0.6], times)  # beside the walker's lane
    alone = SPACE_TIME.lattice.interpolate(found.unhindered[None], np.array([[3.2, -0.6]]))[0]
    assert ahead[0] > alone + 2.0
    np.testing.assert_allclose(np.diff(ahead), -0.25, atol=0.03)  # a second of waiting brings the goal a second nearer
    later = to_go(found, [3.2, -0.6], 11.0)
    assert later == pytest.approx(alone, abs=0.05)


def test_neither_waiting_nor_going_on_can_bring_more_than_the_time_that_it_takes():
    found = SPACE_TIME.times(bridge(((4.0, -0.4), (4.0, 0.4), 0.8, 0.3)), GOAL, CLEARANCE)
    moments = SPACE_TIME.interval * np.arange(0, 30)
    for point in ([2.0, 0.0], [3.0, 0.2], [5.0, 0.0]):
        now, later = to_go(found, point, moments), moments + SPACE_TIME.interval
        waited, moved = (to_go(found, np.add(point, (step, 0.0)), later) for step in (0.0, 0.4))
        assert (now <= SPACE_TIME.interval + np.minimum(waited, moved) + 0.06).all()


def test_people_are_the_only_thing_that_time_changes_and_the_horizon_ends_them():
    found = SPACE_TIME.times(bridge(((4.0, 0.0), (4.0, 0.0), 0.0, 0.0)), GOAL, CLEARANCE)  # stands in the gap
    before = to_go(found, [2.0, 0.0], np.array([0.0, 5.0, 11.9, 12.0, 50.0]))
    assert (before[:2] > before[3] + 5.0).all()
    assert before[3] == before[4] == pytest.approx(5.0 / 1.6, rel=0.03)
    assert np.isfinite(before).all()


def test_times_are_finite_everywhere_and_zero_beyond_the_line():
    found = SPACE_TIME.times(bridge(((2.0, 0.0), (6.0, 0.0), 0.7, 0.0)), GOAL, CLEARANCE)
    assert found.extra.shape == SPACE_TIME.shape
    rng = np.random.default_rng(2)
    points = rng.uniform((-2.0, -3.0), (10.0, 3.0), (300, 2))
    times = to_go(found, points, rng.uniform(0.0, 20.0, 300))
    assert np.isfinite(times).all()
    assert (times >= -1e-4).all()
    assert times.max() < 60
    np.testing.assert_allclose(times[points[:, 0] >= GOAL + 0.3], 0.0, atol=1e-6)


def test_a_bridge_that_nobody_can_cross_has_finite_times_too():
    closed = dataclasses.replace(bridge(), blocks=np.array([[4.0, 0.0, 0.0, 0.2, 1.0]]))
    found = SPACE_TIME.times(closed, GOAL, CLEARANCE)
    assert np.isfinite(found.unhindered).all()
    assert (np.abs(found.extra) < 1e-3).all()
