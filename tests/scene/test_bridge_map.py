import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from shapely import affinity

from armctl.core.errors import ConfigurationError
from armctl.scene import BridgeMap, PedestrianTrajectories

LENGTH, HALF_WIDTH = 20.0, 1.39


def random_map(rng, blocks=7, walkers=0):
    drawn = np.column_stack(
        (
            rng.uniform(2.5, 18, blocks),
            rng.uniform(-1.4, 1.4, blocks),
            rng.uniform(-0.8, 0.8, blocks),
            rng.uniform(0.1, 0.4, blocks),
            rng.uniform(0.2, 0.9, blocks),
        )
    )
    start = rng.uniform((2, -1), (18, 1), (walkers, 2))
    way = np.where(rng.random(walkers)[:, None] < 0.5, (3.0, 0.0), (0.0, 1.5))
    pedestrians = PedestrianTrajectories(
        start, start + way, rng.uniform(0.3, 1.2, walkers), rng.uniform(0, 4, walkers), 0.25
    )
    return BridgeMap(LENGTH, HALF_WIDTH, drawn, pedestrians)


def shapes(bridge):
    """Blocks and edge by shapely, which shares no code with armctl."""
    deck = shapely.box(0, -bridge.half_width, bridge.length, bridge.half_width)
    boxes = [
        affinity.translate(affinity.rotate(shapely.box(-a, -b, a, b), yaw, origin=(0, 0), use_radians=True), x, y)
        for x, y, yaw, a, b in bridge.blocks
    ]
    return deck.exterior, boxes


@pytest.mark.parametrize("seed", range(5))
def test_clearances_are_those_of_shapely(seed):
    rng = np.random.default_rng(seed)
    bridge = random_map(rng)
    edge, boxes = shapes(bridge)
    starts = rng.uniform((0, -HALF_WIDTH), (LENGTH, HALF_WIDTH), (300, 2))
    ends = np.clip(starts + rng.normal(0, 1.5, (300, 2)), (0, -HALF_WIDTH), (LENGTH, HALF_WIDTH))
    for start, end, segment, point in zip(
        starts, ends, bridge.segment_clearance(starts, ends), bridge.clearance(starts), strict=True
    ):
        things = (edge, *boxes)
        assert segment == pytest.approx(min(shapely.LineString([start, end]).distance(t) for t in things), abs=1e-9)
        assert max(point, 0) == pytest.approx(min(shapely.Point(start).distance(t) for t in things), abs=1e-9)
        assert (point <= 0) == any(box.covers(shapely.Point(start)) for box in boxes)


@pytest.mark.parametrize("clearance", [0.05, 0.4, 0.8])
def test_the_quick_test_of_one_segment_is_the_exact_one(clearance):
    rng = np.random.default_rng(1)
    for _ in range(20):
        bridge = random_map(rng)
        starts = rng.uniform((-1, -2), (LENGTH + 1, 2), (200, 2))
        ends = starts + rng.normal(0, 1.5, (200, 2)) * (rng.random((200, 1)) < 0.9)  # a tenth are points
        exact = bridge.segment_clearance(starts, ends)
        free = bridge.edge_test(clearance)
        quick = [free(*start, *end) for start, end in zip(starts.tolist(), ends.tolist(), strict=True)]
        disagree = (np.array(quick) != (exact >= clearance)) & (np.abs(exact - clearance) > 1e-9)
        assert not disagree.any()


def crossable_by_flooding(bridge, radius, cell):
    """Whether free cells of a grid connect both ends: needs no idea of walls."""
    x = np.arange(0.5, LENGTH - 0.5, cell)
    y = np.arange(-HALF_WIDTH, HALF_WIDTH + cell / 2, cell)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    free = (bridge.with_lanes_blocked().clearance(grid.reshape(-1, 2)) >= radius).reshape(grid.shape[:2])
    labels, _ = ndimage.label(free, np.ones((3, 3)))
    return bool(set(labels[0]) & set(labels[-1]) - {0})


@pytest.mark.parametrize("walkers", [0, 2])
def test_crossable_is_what_flooding_a_grid_finds(walkers):
    rng, cell, radius = np.random.default_rng(2), 0.04, 0.4
    decided = []
    for _ in range(80):
        bridge = random_map(rng, blocks=int(rng.integers(0, 9)), walkers=walkers)
        if crossable_by_flooding(bridge, radius + cell, cell):
            decided.append(True)
            assert bridge.crossable(radius)
        elif not crossable_by_flooding(bridge, radius - cell, cell):
            decided.append(False)
            assert not bridge.crossable(radius)
    assert len(decided) > 50
    assert 0.2 < np.mean(decided) < 0.9


def test_crossable_at_its_limits():
    nothing = np.zeros((0, 5))
    assert BridgeMap(LENGTH, HALF_WIDTH, nothing).crossable(0.4)
    assert not BridgeMap(LENGTH, HALF_WIDTH, nothing).crossable(1.5)
    gap = np.array([(10, 0.89, 0, 0.2, 0.5), (10, -0.91, 0, 0.2, 0.5)])  # 0.8 m apart
    assert BridgeMap(LENGTH, HALF_WIDTH, gap).crossable(0.399)
    assert not BridgeMap(LENGTH, HALF_WIDTH, gap).crossable(0.401)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_walkers_walk_at_their_speed_between_their_ends(seed):
    rng = np.random.default_rng(seed)
    pedestrians = random_map(rng, walkers=3).pedestrians
    time = np.linspace(0, 30, 3001)
    places, velocities = pedestrians.positions(time), pedestrians.velocities(time)
    assert places.shape == velocities.shape == (3001, 3, 2)
    np.testing.assert_allclose(np.linalg.norm(velocities, axis=-1), np.tile(pedestrians.speed, (3001, 1)))
    low, high = np.minimum(pedestrians.start, pedestrians.end), np.maximum(pedestrians.start, pedestrians.end)
    assert ((places >= low - 1e-9) & (places <= high + 1e-9)).all()
    steps = np.diff(places, axis=0)
    expected = (velocities[:-1] + velocities[1:]) / 2 * 0.01
    turning = np.abs(velocities[1:] - velocities[:-1]).max(axis=-1) > 1e-9
    np.testing.assert_allclose(steps[~turning], expected[~turning], atol=1e-9)
    assert turning.sum() <= 3 * 1.2 * 30 / 1.5
    np.testing.assert_allclose(pedestrians.positions(1.7), pedestrians.positions([1.7])[0])


def test_lanes_along_the_bridge_become_blocks_and_those_across_do_not():
    bridge = random_map(np.random.default_rng(3), walkers=8)
    blocked = bridge.with_lanes_blocked()
    assert bridge.pedestrians.along.any()
    assert not bridge.pedestrians.along.all()
    assert len(blocked.blocks) == len(bridge.blocks) + bridge.pedestrians.along.sum()
    assert len(blocked.pedestrians.speed) == 0
    assert len(bridge.pedestrians.across().speed) == (~bridge.pedestrians.along).sum()
    walked = bridge.pedestrians.positions(np.linspace(0, 30, 300))[:, bridge.pedestrians.along]
    inside = np.min([blocked.clearance(places) for places in walked], axis=0)
    assert (inside <= -0.25 + 1e-9).all()


def test_whoever_has_nowhere_to_go_stands_and_blocks_the_way():
    here = np.array([(5.0, 0.2)])
    pedestrians = PedestrianTrajectories(here, here, np.ones(1), np.zeros(1), 0.25)
    np.testing.assert_array_equal(pedestrians.positions(np.linspace(0, 9, 10)), np.tile(here, (10, 1, 1)))
    np.testing.assert_array_equal(pedestrians.velocities(3.0), [(0, 0)])
    blocked = BridgeMap(LENGTH, HALF_WIDTH, np.zeros((0, 5)), pedestrians).with_lanes_blocked()
    assert blocked.clearance(here)[0] <= -0.25 + 1e-9


def test_nearest_points_are_as_far_as_the_clearance():
    rng = np.random.default_rng(5)
    bridge = random_map(rng)
    points = rng.uniform((3, -HALF_WIDTH), (17, HALF_WIDTH), (200, 2))
    distance = np.linalg.norm(bridge.nearest(points) - points[:, None], axis=-1)
    assert distance.shape == (200, len(bridge.blocks) + 2)
    np.testing.assert_allclose(distance.min(axis=1), np.maximum(bridge.clearance(points), 0), atol=1e-12)


@pytest.mark.parametrize("blocks", [np.zeros(5), np.zeros((2, 4)), [[np.nan] * 5], [[5, 0, 0, -0.1, 0.2]]])
def test_unusable_blocks_are_refused(blocks):
    with pytest.raises(ConfigurationError, match="blocks"):
        BridgeMap(LENGTH, HALF_WIDTH, np.asarray(blocks, dtype=float))


@pytest.mark.parametrize(("length", "half_width"), [(0, 1), (20, -1), (np.nan, 1), (20, np.inf)])
def test_unusable_decks_are_refused(length, half_width):
    with pytest.raises(ConfigurationError, match="deck"):
        BridgeMap(length, half_width, np.zeros((0, 5)))


def test_pedestrians_of_different_numbers_are_refused():
    with pytest.raises(ConfigurationError, match="pedestrians"):
        PedestrianTrajectories(np.zeros((2, 2)), np.zeros((2, 2)), np.ones(3), np.zeros(2), 0.25)
    with pytest.raises(ConfigurationError, match="radius"):
        PedestrianTrajectories(np.zeros((2, 2)), np.ones((2, 2)), np.ones(2), np.zeros(2), -1)


def test_a_shortened_path_keeps_its_start_and_the_clearance():
    rng, shorter = np.random.default_rng(3), 0
    while shorter < 20:
        bridge, clearance = random_map(rng), float(rng.uniform(0.05, 0.3))
        points = rng.uniform((0, -HALF_WIDTH), (LENGTH, HALF_WIDTH), (60, 2))
        points = points[bridge.clearance(points) >= clearance]
        path, free = points[:1], bridge.edge_test(clearance)
        for point in points[1:30]:
            path = np.vstack((path, point)) if free(*path[-1], *point) else path
        if len(path) < 4:
            continue
        ends = points[points[:, 0] > 15]
        cut = bridge.shortened(path, points, ends, clearance)
        np.testing.assert_array_equal(cut[0], path[0])
        assert (cut[-1] == np.vstack((path[-1:], ends))).all(axis=1).any()
        assert (bridge.segment_clearance(cut[:-1], cut[1:]) >= clearance - 1e-9).all()
        before, after = (np.linalg.norm(np.diff(one, axis=0), axis=1).sum() for one in (path, cut))
        assert after <= before
        shorter += after < before
