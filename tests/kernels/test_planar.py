import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armctl.kernels import planar
from armctl.scene import BridgeMap

DECK = planar.Deck(length=20.0, half_width=1.4, walker_radius=0.25, edge=2.0)
OUTLINE = np.array([[0.25, 0.15], [0.23, 0.21]])
NOBODY = np.zeros((0, 2))


def blocks_at(*rows):
    """Blocks as kernels take them, from x, y, yaw and half sizes."""
    x, y, yaw, *sizes = np.array(rows, dtype=float).reshape(-1, 5).T
    return np.column_stack((x, y, np.cos(yaw), np.sin(yaw), *sizes))


def points_of(pose, outline, resolution=41):
    """Points (m, 2) all over a rover's outline."""
    x, y, yaw = pose
    grids = [np.stack(np.meshgrid(np.linspace(-a, a, resolution), np.linspace(-b, b, resolution)), -1).reshape(-1, 2)
             for a, b in outline]  # fmt: skip
    ahead, left = np.concatenate(grids).T
    return np.column_stack(
        (x + ahead * math.cos(yaw) - left * math.sin(yaw), y + ahead * math.sin(yaw) + left * math.cos(yaw))
    )


poses = st.tuples(st.floats(2, 8), st.floats(-1.2, 1.2), st.floats(-3, 3))


@given(poses, poses)
def test_contact_with_a_block_is_that_of_the_points_of_both(pose, block):
    bridge = BridgeMap(20.0, 1.4, np.array([[*block, 0.3, 0.7]]))
    everywhere = np.ones((2, 5), dtype=bool)
    points = points_of(pose, OUTLINE)
    on_sides = (np.abs(points[:, 1]) > 1.4).any()
    depth = bridge.clearance(points).min() if not on_sides else -1.0
    found = planar.touched(DECK, blocks_at((*block, 0.3, 0.7)), everywhere, NOBODY, *pose, OUTLINE)
    if abs(depth) > 0.02:  # the points are so far apart
        assert (found == planar.BARRIER) == (depth < 0)


@given(poses, st.tuples(st.floats(2, 8), st.floats(-1.4, 1.4)))
def test_contact_with_a_person_is_that_of_the_outline_and_a_disc(pose, walker):
    distance = np.linalg.norm(points_of(pose, OUTLINE) - walker, axis=1).min() - DECK.walker_radius
    nothing = np.zeros((2, 5), dtype=bool)
    found = planar.touched(DECK, blocks_at(), nothing, np.array([walker]), *pose, OUTLINE)
    if abs(distance) > 0.02:
        assert (found == planar.OBSTACLE) == (distance < 0)


def test_a_missing_barrier_is_an_open_side():
    barriers = np.ones((2, 5), dtype=bool)
    barriers[0, 2] = False  # left, from 8 to 12 m
    places = ((10, 1.3), (10, -1.3), (6, 1.3))
    touched = [planar.touched(DECK, blocks_at(), barriers, NOBODY, x, y, 0.0, OUTLINE) for x, y in places]
    assert touched == [planar.FREE, planar.BARRIER, planar.BARRIER]


def scenes_of(blocks, walkers):
    return planar.Scenes(blocks[None], np.ones((1, 2, 5), dtype=bool), np.asarray(walkers, dtype=float)[None])


@given(poses, poses, st.tuples(st.floats(2, 8), st.floats(-1.4, 1.4)))
def test_rays_end_where_the_map_says_that_something_is(pose, block, walker):
    pose, block, walker = ((400 + x, *rest) for x, *rest in (pose, block, walker))  # far from both ends
    directions = np.array([[1.0, left] for left in np.linspace(-1.5, 1.5, 31)])
    ranges = np.empty((1, len(directions)))
    scenes = scenes_of(blocks_at((*block, 0.3, 0.7)), [walker])
    endless = DECK._replace(length=1e3)
    sensor = planar.RangeSensor(0.0, directions, 1.4, 10.0, 2.5)
    planar.scan(np.array([0]), endless, scenes, sensor, np.array([pose]), ranges)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    turned = directions @ np.array([[cos, sin], [-sin, cos]])
    bridge = BridgeMap(endless.length, 1.4, np.array([[*block, 0.3, 0.7]]))

    def clearance(points):
        to_walker = np.linalg.norm(points - walker, axis=-1) - DECK.walker_radius
        return np.minimum(bridge.clearance(points), to_walker)

    inside = clearance(np.array([pose[:2]]))[0] < 0
    for along, distance in zip(turned, ranges[0], strict=True):
        length = np.linalg.norm(along)
        if inside:
            assert distance == 0.0
            continue
        way = np.linspace(0, max(distance - 1e-6, 0.0), 50)[:, None] * along + pose[:2]
        assert clearance(way).min() > -1e-6 * length
        if distance < 10.0:
            assert clearance(np.array([pose[:2] + (distance + 1e-6) * along]))[0] < 1e-4


def test_a_rover_keeps_its_limits_and_stops_at_a_contact():
    rover = planar.Rover(6.0, 12.0, OUTLINE)
    scenes = scenes_of(blocks_at((4.0, 0.0, 0.0, 0.3, 0.7)), np.zeros((0, 2)))
    poses, velocities, contacts = rovers = planar.Rovers(
        np.array([[1.0, 0, 0]]), np.zeros((1, 2)), np.zeros(1, dtype=np.int64)
    )
    places, speeds, full_speed = np.zeros((5, 1, 0, 2)), [], np.array([[2.0, 0.0]])
    while not contacts[0]:
        planar.drive(np.array([0]), DECK, scenes, rover, places, 0.1, full_speed, rovers)
        speeds.append(velocities[0, 0])
    assert np.diff([0.0, *speeds]).max() == pytest.approx(0.6)
    assert max(speeds) == pytest.approx(2.0)
    assert contacts[0] == planar.BARRIER
    assert poses[0, 0] == pytest.approx(4.0 - 0.3 - 0.25, abs=0.06)  # at most a tick's way inside
