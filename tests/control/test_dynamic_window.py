import numpy as np

from armctl.control.dynamic_window import arcs, dynamic_window


def test_the_window_is_what_can_be_reached():
    change, limits = np.array((0.4, 0.8)), np.array((1.0, 2.0))
    linear, angular = dynamic_window(np.array((0.8, -1.5)), change, limits, 5)
    assert len(linear) == 5 * 11
    assert (linear.min(), linear.max()) == (0.4, 1.0)
    np.testing.assert_allclose((angular.min(), angular.max()), (-2.0, -0.7))
    linear, _ = dynamic_window(np.array((-3.0, 9.0)), change, limits, 5)
    assert (linear == 0).all()  # thrown beyond its limits, it stops


def test_arcs_are_parts_of_circles():
    clock, pose = np.array((0.1, 0.2, 0.3, 0.4)), np.array((1.0, 2.0, 0.5))
    places, headings = arcs(pose, np.array((1.0, 1.0)), np.array((0.0, 1.2)), clock)
    np.testing.assert_allclose(places[0], pose[:2] + clock[:, None] * (np.cos(0.5), np.sin(0.5)))
    radius = 1 / 1.2
    centre = pose[:2] + radius * np.array((-np.sin(0.5), np.cos(0.5)))
    np.testing.assert_allclose(np.linalg.norm(places[1] - centre, axis=1), radius, atol=1e-3)
    np.testing.assert_allclose(headings, (0.5, 0.98))
