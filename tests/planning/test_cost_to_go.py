import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from armctl.kernels.cost_to_go import keep_clear, nearest_distances
from armctl.planning import Lattice, plan_path
from armctl.planning.cost_to_go import STEPS
from armctl.scene import BridgeMap
from armctl.tasks.bridge.layout import sample_layout

NOTHING = BridgeMap(20.0, 1.4, np.zeros((0, 5)))


def test_lengths_are_those_of_planned_paths():
    rng = np.random.default_rng(0)
    lattice = Lattice(20.0, 1.39)
    ratios = []
    for _ in range(25):
        bridge = sample_layout(rng, 20.0, 4.0, 7, 0, 1).map
        lattice = Lattice(bridge.length, bridge.half_width)
        lengths = lattice.lengths(bridge, 19.0, 0.36)
        assert np.isfinite(lengths).all()
        start = np.array([[1.0, 0.0]])
        ratios.append(lattice.interpolate(lengths[None], start)[0] / plan_path(bridge, start[0], 19.0).length)
    assert min(ratios) > 0.95
    assert max(ratios) < 1.03


def test_without_blocks_it_is_straight_ahead():
    lattice = Lattice(20.0, 1.4)
    points = np.column_stack((np.linspace(1.0, 18.9, 50), np.linspace(-1.0, 1.0, 50)))
    lengths = np.broadcast_to(lattice.lengths(NOTHING, 19.0, 0.3), (50, *lattice.shape))
    np.testing.assert_allclose(lattice.interpolate(lengths, points), 19.0 - points[:, 0], atol=1e-9)


@pytest.mark.parametrize("point", [(-3.0, 0.0), (25.0, 0.0), (10.0, 9.0), (10.0, -9.0)])
def test_points_off_the_deck_have_the_length_of_its_edge(point):
    lattice = Lattice(20.0, 1.4)
    lengths = lattice.lengths(NOTHING, 19.0, 0.3)[None]
    edge = np.clip(point, (0.0, -1.4), (20.0, 1.4))
    off, on = (lattice.interpolate(lengths, np.array([place])) for place in (point, edge))
    np.testing.assert_allclose(off, on, atol=1e-12)


def test_behind_a_block_it_is_further():
    wall = BridgeMap(20.0, 1.4, np.array([[10.0, 0.4, 0.0, 0.2, 1.0]]))
    lattice = Lattice(20.0, 1.4)
    lengths = lattice.lengths(wall, 19.0, 0.2)[None]
    before, beside = lattice.interpolate(np.repeat(lengths, 2, axis=0), np.array([[9.3, 0.4], [9.3, -1.1]]))
    assert before > beside + 0.5
    inside = lattice.interpolate(lengths, np.array([[10.0, 0.4]]))[0]
    assert inside > beside


def test_lanes_along_the_bridge_count_as_blocks():
    rng = np.random.default_rng(1)
    bridge = next(
        layout.map
        for layout in (sample_layout(rng, 20.0, 4.0, 3, 3, 1) for _ in range(50))
        if layout.map.pedestrians.along.any()
    )
    lattice = Lattice(bridge.length, bridge.half_width)
    with_lanes = lattice.lengths(bridge, 19.0, 0.36)
    without = lattice.lengths(BridgeMap(bridge.length, bridge.half_width, bridge.blocks), 19.0, 0.36)
    assert (with_lanes >= without - 1e-9).all()
    assert (with_lanes > without + 0.1).any()


@pytest.mark.parametrize("share", [0.0, 0.1, 0.4])
def test_lengths_are_dijkstras(share):
    rng, lattice = np.random.default_rng(0), Lattice(8.0, 1.5, 0.15)
    index = np.arange(np.prod(lattice.shape)).reshape(lattice.shape)
    for _ in range(5):
        free = rng.random(lattice.shape) >= share
        places = np.argwhere(free)
        weights = np.zeros((free.size, free.size))
        for step in STEPS:
            ends = places + step
            inside = ((ends >= 0) & (ends < lattice.shape)).all(axis=1)
            starts, ends = places[inside], ends[inside]
            open_ = free[tuple(ends.T)]
            starts, ends = index[tuple(starts[open_].T)], index[tuple(ends[open_].T)]
            weights[starts, ends] = np.hypot(*(lattice.spacings * step))
        beyond_goal = np.broadcast_to(lattice.axes[0][:, None] >= 7.5, free.shape)
        expected = dijkstra(csr_array(weights), directed=False, indices=index[beyond_goal & free], min_only=True)
        bridge = BridgeMap(8.0, 1.5, np.zeros((0, 5)))
        object.__setattr__(bridge, "free", lambda x, y, clearance, free=free: free)
        lengths = lattice.paths(bridge, 7.5, 0.3)
        np.testing.assert_array_equal(lengths, np.where(beyond_goal, 0.0, expected.reshape(free.shape)))


def test_distances_to_points_are_exact_up_to_the_farthest():
    rng = np.random.default_rng(0)
    x, y = np.linspace(0.0, 3.0, 31), np.linspace(-1.0, 1.0, 17)
    lattice = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    for count in (0, 1, 40):
        obstacles = rng.uniform((-1.0, -2.0), (4.0, 2.0), (count, 2))
        expected = np.linalg.norm(lattice[..., None, :] - obstacles, axis=-1).min(axis=-1, initial=np.inf)
        free, distances = np.empty(lattice.shape[:2], dtype=bool), np.empty(lattice.shape[:2])
        keep_clear(obstacles, x, y, 0.3, free)
        np.testing.assert_array_equal(free, expected >= 0.3)
        nearest_distances(obstacles, lattice.reshape(-1, 2), 0.7, distances.reshape(-1))
        np.testing.assert_allclose(distances, np.minimum(expected, 0.7), atol=1e-12)
