import numpy as np
import pytest

from armctl.planning import Lattice, plan_path
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
