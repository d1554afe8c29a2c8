import numpy as np
import pytest

from armctl.estimation.corridor_localization import Corridor, CorridorLocalization

CORRIDOR = Corridor(1.39, lean=0.3, foot=0.1)
BEARINGS = np.linspace(-0.9, 0.9, 40)


def walls_from(pose, height=0.3):
    """Points (m, 2) of the walls in the robot's frame, from a pose (3,), at a height."""
    angles = BEARINGS + pose[2]
    wall = CORRIDOR.half_width_at(np.array(height))
    ranges = (np.copysign(wall, np.sin(angles)) - pose[1]) / np.sin(angles)
    points = ranges[:, None] * np.column_stack((np.cos(BEARINGS), np.sin(BEARINGS)))
    return points[ranges < 8]


def believed(pose=(0.0, 0.0, 0.0), slide=0.0):
    return CorridorLocalization(pose, CORRIDOR, slide)


def test_it_moves_on_arcs_and_slides_outwards():
    arc, sliding = believed(), believed(slide=0.1)
    for _ in range(10):
        arc.predict(1.0, 0.5, 0.1)
        sliding.predict(1.0, 0.5, 0.1)
    np.testing.assert_allclose(arc.pose, (2 * np.sin(0.5), 2 * (1 - np.cos(0.5)), 0.5), atol=1e-3)
    assert sliding.pose[1] == pytest.approx(arc.pose[1] - 0.05 * np.sin(0.5) / 0.5, abs=1e-3)


def test_walls_correct_heading_and_lateral_position_and_leave_the_way_along_them():
    belief, truth = believed((3.0, 0.08, 0.04)), (3.0, 0.0, 0.0)
    points = walls_from(truth)
    for _ in range(5):
        belief.correct(points, np.full(len(points), 0.3))
    np.testing.assert_allclose(belief.pose, truth, atol=0.01)


def test_it_survives_noise_on_odometry_and_points_and_obstacles_that_are_no_walls():
    rng, belief, truth = np.random.default_rng(1), believed(), np.zeros(3)
    errors = []
    for step in range(200):
        turn = 0.6 * np.cos(step / 5)
        middle = truth[2] + 0.05 * turn
        truth = truth + np.array((0.1 * np.cos(middle), 0.1 * np.sin(middle), 0.1 * turn))
        belief.predict(1.0 + 0.1 * rng.standard_normal(), turn + 0.1 * rng.standard_normal(), 0.1)
        points = walls_from(truth)
        points = points + 0.05 * rng.standard_normal(points.shape)
        block = np.column_stack((np.full(8, 2.0), np.linspace(-0.4, 0.8, 8)))
        points = np.vstack((points, block))
        belief.correct(points, np.full(len(points), 0.3))
        errors.append(belief.pose - truth)
    assert np.abs(errors)[:, 1].max() < 0.08
    assert np.abs(errors)[:, 2].max() < 0.06


def test_without_walls_it_only_becomes_less_certain():
    belief = believed()
    belief.correct(np.zeros((0, 2)), np.zeros(0))
    np.testing.assert_array_equal(belief.pose, 0.0)
    before = belief.covariance.copy()
    belief.predict(1.0, 0.0, 0.1)
    assert (np.diag(belief.covariance) > np.diag(before)).all()
