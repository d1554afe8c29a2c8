import numpy as np
import pytest

from armctl.estimation.occupancy_grid import OccupancyGrid, smallest_box

BEARINGS = np.linspace(-0.5, 0.5, 60)


def look(grid, origin, x, y=(-0.4, 0.4), times=4):
    """Enter what is seen from `origin` of a wall across at `x`, from `y` to `y`; all else is free for 6 m."""
    origin = np.array(origin)
    directions = np.column_stack((np.cos(BEARINGS), np.sin(BEARINGS)))
    ranges = (x - origin[0]) / directions[:, 0]
    sides = origin[1] + ranges * directions[:, 1]
    hits = (sides > y[0]) & (sides < y[1])
    for _ in range(times):
        grid.add(origin, directions, np.where(hits, ranges, 6.0), hits)


def test_a_wall_that_is_seen_from_two_poses_is_one_wall():
    grid = OccupancyGrid((0.0, -2.0), (12.0, 2.0))
    look(grid, (0.5, 0.0), 4.0)
    look(grid, (1.5, 0.3), 4.0)
    (box,) = grid.boxes()
    front = box[0] - min(box[3], box[4])
    assert front == pytest.approx(4.0, abs=0.06)
    assert max(box[3], box[4]) == pytest.approx(0.4, abs=0.08)


def test_what_is_seen_through_is_gone_and_what_is_hidden_stays():
    grid = OccupancyGrid((0.0, -2.0), (12.0, 2.0))
    look(grid, (0.5, 0.0), 4.0)
    look(grid, (0.5, 0.0), 2.5)
    assert len(grid.boxes()) == 2
    look(grid, (0.5, 0.0), 2.5, y=(9, 9), times=20)
    assert not len(grid.boxes())


def test_a_single_wrong_point_is_no_obstacle_and_points_are_forgotten():
    grid = OccupancyGrid((0.0, -2.0), (12.0, 2.0))
    look(grid, (0.5, 0.0), 4.0, times=1)
    assert not len(grid.boxes())
    look(grid, (0.5, 0.0), 4.0)
    assert grid.near_occupied(np.array(((4.0, 0.0), (3.0, 0.0), (np.nan, 0.0), (99.0, 0.0)))).tolist() == [
        True, False, False, False,
    ]  # fmt: skip
    grid.forget(np.array(((4.1, 0.0),)), 0.6)
    assert not len(grid.boxes())


def test_boxes_do_not_depend_on_when_they_were_asked_for():
    often, once = (OccupancyGrid((0.0, -2.0), (12.0, 2.0)) for _ in range(2))
    rng = np.random.default_rng(0)
    for _ in range(12):
        x, y = rng.uniform((2.5, -1.5), (8.0, 1.2))
        for grid in (often, once):
            look(grid, (0.5, 0.0), x, (y, y + 0.3), times=2)
        often.boxes()
    assert len(once.boxes()) > 2
    np.testing.assert_array_equal(often.boxes(), once.boxes())


@pytest.mark.parametrize("yaw", [0.0, 0.3, 1.2])
def test_the_least_box_of_a_turned_box_is_the_box(yaw):
    along, across = np.meshgrid(np.linspace(-0.6, 0.6, 9), np.linspace(-0.2, 0.2, 4))
    turn = np.array(((np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw))))
    x, y, found, half_length, half_width = smallest_box(
        np.column_stack((along.ravel(), across.ravel())) @ turn + (2, 1)
    )
    np.testing.assert_allclose((x, y), (2, 1), atol=1e-9)
    np.testing.assert_allclose(sorted((half_length, half_width)), (0.2, 0.6), atol=1e-6)
    assert min((found - yaw) % (np.pi / 2), (yaw - found) % (np.pi / 2)) < 1e-6


def test_boxes_of_a_point_and_of_a_line_have_no_width():
    assert smallest_box(np.array(((1.0, 2.0),)))[3:] == (0, 0)
    line = np.column_stack((np.linspace(0, 1, 5), np.zeros(5)))
    assert sorted(smallest_box(line)[3:]) == [0, 0.5]
