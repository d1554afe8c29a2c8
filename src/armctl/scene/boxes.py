"""Boxes: obstacles of an arm, for simulator and controllers alike."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError

BOX_NUMBERS = 7
"""Numbers of a box: centre (3) and half sizes (3), m, and yaw, rad. Half sizes of 0: there is none."""
TILTED_BOX_NUMBERS = 8
"""Numbers of a box that may be tilted: the same, and its tilt, rad."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """k boxes, rotated about the vertical, maybe after a tilt about their own y axis; lengths in m."""

    centres: Array
    """(k, 3)"""
    half_sizes: Array
    """(k, 3)"""
    yaws: Array
    """(k,) rad"""
    tilts: Array | None = None
    """(k,) rad; None: all upright."""

    def __post_init__(self) -> None:
        angles = (self.yaws,) if self.tilts is None else (self.yaws, self.tilts)
        shapes = [np.shape(self.centres), np.shape(self.half_sizes), *map(np.shape, angles)]
        if shapes != [(len(self.yaws), 3), (len(self.yaws), 3), *[(len(self.yaws),)] * len(angles)]:
            raise ConfigurationError(f"boxes should have arrays of shapes (k, 3), (k, 3) and (k,), not {shapes}")
        numbers = np.concatenate([np.ravel(self.centres), np.ravel(self.half_sizes), *map(np.ravel, angles)])
        if not (np.isfinite(numbers).all() and (self.half_sizes > 0).all()):
            raise ConfigurationError("boxes should have finite numbers and half sizes above 0")

    def __len__(self) -> int:
        return len(self.yaws)

    @property
    def numbers(self) -> Array:
        """(k, `BOX_NUMBERS`), or (k, `TILTED_BOX_NUMBERS`) with tilts."""
        columns = (self.centres, self.half_sizes, self.yaws)
        return np.column_stack(columns if self.tilts is None else (*columns, self.tilts))

    @property
    def rotations(self) -> Array:
        """Rotation matrices from each box's own frame to the world's, (k, 3, 3)."""
        return box_rotations(self.yaws, self.tilts)

    def distances(self, points: ArrayLike) -> Array:
        """Return signed distances of points (..., 3) from the boxes' surfaces, (..., k) m: negative inside."""
        local = np.einsum("kji,...kj->...ki", self.rotations, np.asarray(points, float)[..., None, :] - self.centres)
        beyond = np.abs(local) - self.half_sizes
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(beyond.max(axis=-1), 0.0))


def box_rotations(yaws: Array, tilts: Array | None = None) -> Array:
    """Return rotation matrices (..., 3, 3) from boxes' own frames, by yaws and tilts (...), rad; None: all upright."""
    upright = rotations_about_vertical(yaws)
    if tilts is None:
        return upright
    sine, cosine, zero, unit = np.sin(tilts), np.cos(tilts), 0 * tilts, 1 + 0 * tilts
    tilted = np.array([[cosine, zero, sine], [zero, unit, zero], [-sine, zero, cosine]])
    return np.asarray(upright @ np.moveaxis(tilted, (0, 1), (-2, -1)))


def rotations_about_vertical(angles: Array) -> Array:
    """Return rotation matrices (..., 3, 3) by angles (...), rad."""
    sine, cosine, zero, unit = np.sin(angles), np.cos(angles), 0 * angles, 1 + 0 * angles
    rows = [[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, unit]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


NO_BOXES = Boxes(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
