"""A polyline by arc length: what everything that follows a path asks of it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.errors import ConfigurationError

Array = NDArray[np.float64]

SPACING = 0.025
"""m between the points among which the nearest is looked for."""


class ArcPath:
    """One path (m, 2), m, of at least two points, and straight on beyond its ends."""

    def __init__(self, path: ArrayLike) -> None:
        points = np.asarray(path, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
            raise ConfigurationError(f"a path is an array (m, 2) of at least two finite points, not {path!r}")
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.concatenate(([True], steps > 1e-9))
        if keep.sum() < 2:
            raise ConfigurationError("a path leads somewhere else than where it begins")
        self._points = points[keep]
        self._arc = np.concatenate(([0.0], np.cumsum(steps[keep[1:]])))
        self._ways = np.diff(self._points, axis=0) / np.diff(self._arc)[:, None]

    @property
    def length(self) -> float:
        """Of the path, m."""
        return float(self._arc[-1])

    def points_at(self, arc_lengths: ArrayLike) -> Array:
        """Points (..., 2) of the path at arc lengths (...), m."""
        arc = np.asarray(arc_lengths, dtype=float)
        segment = np.clip(np.searchsorted(self._arc, arc, side="right") - 1, 0, len(self._ways) - 1)
        return np.asarray(self._points[segment] + self._ways[segment] * (arc - self._arc[segment])[..., None])

    def nearest(self, points: ArrayLike, low: float, high: float) -> Array:
        """Arc lengths (...) from `low` to `high`, m, where the path is nearest to points (..., 2)."""
        arc = np.linspace(low, high, round((high - low) / SPACING) + 1)
        apart = np.asarray(points, dtype=float)[..., None, :] - self.points_at(arc)
        return np.asarray(arc[np.argmin((apart * apart).sum(axis=-1), axis=-1)])
