import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armctl.scene.routes import Routes

seconds = st.floats(-100, 300)


def routes(seed, n=3, k=5):
    """Routes with k corners, of which the second one has repeated last ones."""
    rng = np.random.default_rng(seed)
    corners, times = rng.uniform(-10, 10, (n, k, 2)), np.cumsum(rng.uniform(0.5, 5.0, (n, k)), axis=1) - 20.0
    corners[1, -2:], times[1, -2:] = corners[1, 2], times[1, 2]
    return Routes.through(corners, times, 0.5)


@given(st.integers(0, 100), st.lists(seconds, min_size=1, max_size=4))
def test_positions_are_those_of_a_linear_interpolation_back_and_forth(seed, times):
    moving = routes(seed)
    for i, (corners, at) in enumerate(zip(moving.corners, moving.times, strict=True)):
        there = np.mod(np.array(times) - at[0], 2 * (at[-1] - at[0]))
        clock = at[0] + np.minimum(there, 2 * (at[-1] - at[0]) - there)
        distinct = np.append(True, np.diff(at) > 0)
        expected = np.stack([np.interp(clock, at[distinct], axis[distinct]) for axis in corners.T], axis=-1)
        np.testing.assert_allclose(moving.positions(times)[:, i], expected, atol=1e-9)


@given(st.integers(0, 100), seconds)
def test_a_velocity_is_the_rate_of_the_position_or_the_other_way_at_a_corner(seed, time):
    moving, step = routes(seed), 1e-6
    rate = (moving.positions(time + step) - moving.positions(time)) / step
    ends = np.concatenate((moving.velocities(time), moving.velocities(time + step)))
    same = [np.linalg.norm(ends[[i, i + 3]] - rate[i], axis=-1).min() < 1e-3 for i in range(3)]
    between = np.linalg.norm(rate, axis=-1) <= np.linalg.norm(ends.reshape(2, 3, 2), axis=-1).max(axis=0) + 1e-3
    assert all(np.array(same) | between)


def test_bridges_side_by_side_are_those_one_by_one():
    first, second = routes(1), routes(2)
    both = Routes.through(np.stack((first.corners, second.corners)), np.stack((first.times, second.times)), 0.5)
    times = np.array([[3.0, 7.0], [11.0, 2.0]])
    together = both.positions(times)
    for tick, bridge in np.ndindex(2, 2):
        alone = (first, second)[bridge]
        np.testing.assert_array_equal(together[tick, bridge], alone.positions(times[tick, bridge]))
    np.testing.assert_array_equal(both.velocities(times[0])[1], second.velocities(7.0))


def test_lanes_are_all_segments_that_have_a_length():
    moving = routes(3)
    assert moving.lanes.shape == (4 + 2 + 4, 4)
    for time in np.linspace(0.0, 60.0, 50):
        for place in moving.positions(time):
            ahead = moving.lanes[:, 2:] - moving.lanes[:, :2]
            offset = place - moving.lanes[:, :2]
            share = np.clip((offset * ahead).sum(axis=1) / (ahead * ahead).sum(axis=1), 0.0, 1.0)
            assert np.linalg.norm(offset - share[:, None] * ahead, axis=1).min() < 1e-9


@pytest.mark.parametrize("time", [0.0, 9.5])
def test_routes_that_are_moved_keep_their_shape(time):
    moving, offset = routes(4), np.array([0.3, -0.2])
    moved = moving.moved_to(moving.start + offset, moving.end + offset)
    np.testing.assert_allclose(moved.positions(time), moving.positions(time) + offset)
    np.testing.assert_allclose(moved.velocities(time), moving.velocities(time))
    assert not moving.along.any()
    assert moving.across() is moving
