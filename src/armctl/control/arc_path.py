"""A polyline parametrised by arc length, for path followers."""

import numpy as np
from numpy.typing import ArrayLike

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kernels import arc_path as kernel

SPACING = 0.025
"""m: resolution of the search for the nearest point."""


class ArcPath:
    """Arc-length parametrisation of a path (m, 2), m, of at least two points, extended straight beyond its ends."""

    def __init__(self, path: ArrayLike) -> None:
        points = np.asarray(path, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
            raise ConfigurationError(f"path should be an array (m, 2) of at least two finite points, not {path!r}")
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.concatenate(([True], steps > 1e-9))
        if keep.sum() < 2:
            raise ConfigurationError(f"path should have a length above 0, not {path!r}")
        points, arcs = points[keep], np.concatenate(([0.0], np.cumsum(steps[keep[1:]])))
        directions = np.diff(points, axis=0) / np.diff(arcs)[:, None]
        self.segments = np.column_stack((arcs[:-1], points[:-1], directions))
        """The straight parts as rows (k, 5): arc length (m), the point x, y (m) and the direction where one begins."""
        self.length = float(arcs[-1])
        """Length of the path, m."""

    def points_at(self, arc_lengths: ArrayLike) -> Array:
        """Return points (..., 2) of the path at arc lengths (...), m."""
        arcs = np.asarray(arc_lengths, dtype=float)
        points = np.empty((*arcs.shape, 2))
        kernel.points_at(self.segments, arcs.ravel(), points.reshape(-1, 2))
        return points

    def nearest(self, points: ArrayLike, low: float, high: float) -> Array:
        """Return arc lengths (...) m, between `low` and `high`, of the path's points nearest to `points` (..., 2)."""
        points = np.ascontiguousarray(points, dtype=float)
        arcs = np.empty(points.shape[:-1])
        kernel.nearest(self.segments, points.reshape(-1, 2), low, high, SPACING, arcs.reshape(-1))
        return arcs
