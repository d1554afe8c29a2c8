"""A polyline parametrised by arc length, for path followers."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.errors import ConfigurationError

Array = NDArray[np.float64]

SPACING = 0.025
"""m: resolution of the search for the nearest point."""


class ArcPath:
    """One path (m, 2), m, of at least two points, extended straight beyond its ends."""

    def __init__(self, path: ArrayLike) -> None:
        points = np.asarray(path, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
            raise ConfigurationError(f"path should be an array (m, 2) of at least two finite points, not {path!r}")
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.concatenate(([True], steps > 1e-9))
        if keep.sum() < 2:
            raise ConfigurationError(f"path should have a length above 0, not {path!r}")
        self._points = points[keep]
        self._arc = np.concatenate(([0.0], np.cumsum(steps[keep[1:]])))
        self._directions = np.diff(self._points, axis=0) / np.diff(self._arc)[:, None]

    @property
    def length(self) -> float:
        """Length of the path, m."""
        return float(self._arc[-1])

    def points_at(self, arc_lengths: ArrayLike) -> Array:
        """Points (..., 2) of the path at arc lengths (...), m."""
        arc = np.asarray(arc_lengths, dtype=float)
        segment = np.clip(np.searchsorted(self._arc, arc, side="right") - 1, 0, len(self._directions) - 1)
        return np.asarray(self._points[segment] + self._directions[segment] * (arc - self._arc[segment])[..., None])

    def nearest(self, points: ArrayLike, low: float, high: float) -> Array:
        """Arc lengths (...) m, between `low` and `high`, of the path's points nearest to `points` (..., 2)."""
        arc = np.linspace(low, high, round((high - low) / SPACING) + 1)
        offset = np.asarray(points, dtype=float)[..., None, :] - self.points_at(arc)
        return np.asarray(arc[np.argmin((offset * offset).sum(axis=-1), axis=-1)])
