import numpy as np
import pytest

from armctl.control.arc_path import SPACING, ArcPath
from armctl.core.errors import ConfigurationError


def test_points_along_the_path_and_beyond_both_ends():
    path = ArcPath([(0, 0), (3, 4), (3, 4), (3, 10)])
    assert path.length == pytest.approx(11)
    np.testing.assert_allclose(path.points_at([[-5, 0], [5, 8], [11, 13]])[:, 0], [(-3, -4), (3, 4), (3, 10)])
    np.testing.assert_allclose(path.points_at([[-5, 0], [5, 8], [11, 13]])[:, 1], [(0, 0), (3, 7), (3, 12)])


def test_the_nearest_place_is_found_where_it_is_looked_for():
    there_and_back = ArcPath([(0, 0), (5, 0), (5, 0.2), (0, 0.2)])
    points = np.array([[(1.0, 0.5), (4.0, -1.0)]])
    np.testing.assert_allclose(there_and_back.nearest(points, 0.0, 4.0), [[1.0, 4.0]], atol=SPACING)
    np.testing.assert_allclose(there_and_back.nearest(points, 5.5, 10.2), [[9.2, 6.2]], atol=SPACING)
    np.testing.assert_allclose(there_and_back.nearest((9.0, 0.0), 2.0, 3.0), 3.0)


@pytest.mark.parametrize("path", [[(0, 0)], [(1, 1), (1, 1)], [(0, 0), (np.inf, 1)], [(0, 0, 0), (1, 1, 1)]])
def test_unusable_paths_are_refused(path):
    with pytest.raises(ConfigurationError, match="path"):
        ArcPath(path)
