"""Ranges per column of a depth image: how far the way is free in each direction.

Points that stand out of the deck are obstacles, and where the camera sees far below the deck there is a hole. A rover
nods when it speeds up or brakes, so the camera's pitch is estimated first, from two rows of the image that show the
deck before the wheels.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from armctl.core.arrays import Array

MAX_NOD = 0.25
"""rad: largest deviation of the pitch from that at rest."""
OBSTACLE_HEIGHTS = (0.12, 0.75)
"""m above the deck, between which a point belongs to an obstacle."""
HOLE_HEIGHT = -0.5
"""m: a point below it belongs to a hole."""
MAX_RISE = -0.12
"""Rise of a ray per m of depth, above which no hole is looked for."""
DECK_ROWS = (31 / 32, 24 / 32)
"""Shares of the image's height, at which rows show the deck before the wheels."""


@dataclass(frozen=True)
class DepthCamera:
    """A depth camera that looks ahead."""

    height: int
    """Rows of its image."""
    width: int
    """Columns of its image."""
    field_of_view: float
    """Horizontal, degrees."""
    farthest: float
    """m."""
    pitch: float
    """rad by which it looks down at rest."""

    @functools.cached_property
    def directions(self) -> Array:
        """(width, 2) unit vectors, ahead and left, of the columns at the horizon."""
        bearings = np.arctan2(self.sideways, 1 / math.cos(self.pitch))
        return np.column_stack((np.cos(bearings), np.sin(bearings)))

    def ranges(self, depths: ArrayLike) -> Array:
        """Return horizontal distances (width,) m from the camera, at most `farthest`, for depths (height, width) m."""
        depths = np.asarray(depths, dtype=float)
        up = self.up[:, None]
        tangent, lowest = self._tangent_of_pitch(depths)
        cos = 1 / math.sqrt(1 + tangent * tangent)
        sin = tangent * cos
        camera_height = lowest * (sin - float(self.up[self._deck_rows[0]]) * cos)
        rise, reach = up * cos - sin, np.hypot(cos + up * sin, self.sideways)
        heights = camera_height + rise * depths
        is_obstacle = (heights > OBSTACLE_HEIGHTS[0]) & (heights < OBSTACLE_HEIGHTS[1])
        is_hole = (heights < HOLE_HEIGHT) & (rise < MAX_RISE)
        to_hole = -camera_height / np.minimum(rise, MAX_RISE)
        distances = np.where(is_obstacle, depths * reach, np.where(is_hole, to_hole * reach, self.farthest))
        return np.asarray(distances.min(axis=0).clip(0.0, self.farthest))

    def _tangent_of_pitch(self, depths: Array) -> tuple[float, float]:
        """Return the tangent of the present pitch, and the depth (m) of the deck in the lowest of `DECK_ROWS`."""
        (first, second), up = self._deck_rows, self.up
        lower, upper = float(depths[first].max()), float(depths[second].max())
        tangent = (upper * up[second] - lower * up[first]) / max(upper - lower, 0.02)
        return float(np.clip(tangent, math.tan(self.pitch - MAX_NOD), math.tan(self.pitch + MAX_NOD))), lower

    @functools.cached_property
    def _deck_rows(self) -> tuple[int, int]:
        first, second = (min(int(share * self.height), self.height - 1) for share in DECK_ROWS)
        return first, second

    @functools.cached_property
    def pixel(self) -> float:
        """Width of a pixel at a depth of 1."""
        return 2 * math.tan(math.radians(self.field_of_view) / 2) / self.width

    @functools.cached_property
    def up(self) -> Array:
        """(height,) offsets of the rows' rays upwards at a depth of 1."""
        return np.asarray((self.height / 2 - np.arange(self.height) - 0.5) * self.pixel)

    @functools.cached_property
    def sideways(self) -> Array:
        """(width,) offsets of the columns' rays to the left at a depth of 1."""
        return np.asarray((self.width / 2 - np.arange(self.width) - 0.5) * self.pixel)
