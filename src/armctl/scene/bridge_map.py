"""The map of a bridge: its sides, its blocks and its pedestrians.

x runs along the bridge from its start, y across it from its centre line.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kernels import bridge as kernel
from armctl.scene.pedestrians import NO_PEDESTRIANS, PedestrianTrajectories

EdgeTest = Callable[[float, float, float, float], bool]


@dataclass(frozen=True, eq=False)
class BridgeMap:
    """A bridge from above. Raises `ConfigurationError` for invalid sizes."""

    length: float
    """m: length of the deck"""
    half_width: float
    """m: half the free width between the barriers; |y| is less on the deck"""
    blocks: Array
    """(k, 5): x, y (m), yaw (rad), half length and half width (m) of the obstacles on the deck"""
    pedestrians: PedestrianTrajectories = NO_PEDESTRIANS

    def __post_init__(self) -> None:
        if not (0 < self.length < math.inf and 0 < self.half_width < math.inf):
            raise ConfigurationError(
                f"deck length and half width should be above 0 m, not {self.length} and {self.half_width}"
            )
        shape = np.shape(self.blocks)
        if len(shape) != 2 or shape[1] != 5 or not np.isfinite(self.blocks).all() or (self.blocks[:, 3:] < 0).any():
            raise ConfigurationError(
                f"blocks should be rows of x, y, yaw, half length and half width, not {self.blocks}"
            )

    def clearance(self, points: ArrayLike) -> Array:
        """Return the distance (m,) of points (m, 2) to the nearest block, side or end; 0 or below in a block."""
        points = np.ascontiguousarray(points, dtype=float)
        clearances = np.empty(len(points))
        kernel.clearances(*self.deck, points, clearances)
        return clearances

    def free(self, x: Array, y: Array, clearance: float) -> NDArray[np.bool_]:
        """Return which points of a lattice have a clearance (m), (nx, ny), for its `x` (nx,) and `y` (ny,), m."""
        points = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        return np.asarray((self.clearance(points) >= clearance).reshape(len(x), len(y)))

    def nearest(self, points: ArrayLike) -> Array:
        """Return the point of each block and of the two sides nearest to each of points (m, 2): (m, k + 2, 2)."""
        points = np.ascontiguousarray(points, dtype=float)
        nearest_points = np.empty((len(points), len(self.blocks) + 2, 2))
        kernel.nearest(*self.deck, points, nearest_points)
        return nearest_points

    def segment_clearance(self, starts: ArrayLike, ends: ArrayLike) -> Array:
        """Return the exact distance (m,) of segments between points (m, 2) to the nearest block, side or end.

        0 or below for segments that meet it.
        """
        starts, ends = np.ascontiguousarray(starts, dtype=float), np.ascontiguousarray(ends, dtype=float)
        clearances = np.empty(len(starts))
        kernel.segment_clearances(*self.deck, starts, ends, clearances)
        return clearances

    def edge_test(self, clearance: float) -> EdgeTest:
        """Return a test for single segments, from x, y to x, y: whether `segment_clearance` is at least `clearance`."""
        return functools.partial(kernel.edge_is_free, *self.deck, clearance)

    def shortened(self, path: Array, points: Array, ends: Array, clearance: float) -> Array:
        """Shorten a path (m, 2): corners are left out, or moved to other `points` (n, 2), as the clearance allows.

        It may end at any of `ends` (k, 2).
        """
        path = np.array(path)
        return path[: kernel.shorten((*self.deck, clearance), path, points, ends)]

    @functools.cached_property
    def deck(self) -> tuple[Array, float, float]:
        """Rows of blocks, half width and length, as `armctl.kernels.bridge` takes them."""
        corners, (x, y, _, *sizes) = self.corners, self.blocks.T
        low, high = corners.min(axis=1, initial=np.inf), corners.max(axis=1, initial=-np.inf)
        return np.column_stack((low, high, x, y, *self._directions, *sizes)), self.half_width, self.length

    def with_lanes_blocked(self) -> "BridgeMap":
        """Return the map with a block in place of each lane along the bridge, and without pedestrians.

        A path can lead beside such a lane, whereas a lane across the bridge has to be crossed.
        """
        pedestrians = self.pedestrians
        if not len(pedestrians.speed):
            return self
        start, end = pedestrians.start[pedestrians.along], pedestrians.end[pedestrians.along]
        (x, y), (lane_x, lane_y) = (start + end).T / 2, (end - start).T
        half_length, half_width = np.hypot(lane_x, lane_y) / 2 + pedestrians.radius, np.full(len(x), pedestrians.radius)
        lanes = np.column_stack((x, y, np.arctan2(lane_y, lane_x), half_length, half_width))
        return dataclasses.replace(self, blocks=np.vstack((self.blocks, lanes)), pedestrians=NO_PEDESTRIANS)

    def crossable(self, radius: float) -> bool:
        """Return True if a disc can pass all blocks, beside the lanes along the bridge: exact.

        By duality, it cannot if and only if blocks with gaps too narrow for it form a wall from side to side.
        """
        bridge = self.with_lanes_blocked()
        y = bridge.corners[..., 1]
        right = y.min(axis=1, initial=np.inf) + self.half_width < 2 * radius
        near_left_side = self.half_width - y.max(axis=1, initial=-np.inf) < 2 * radius
        narrow = bridge._gaps() < 2 * radius
        wall = right
        while (grown := narrow[wall].any(axis=0) | right).sum() > wall.sum():
            wall = grown
        return bool(radius <= self.half_width and not (wall & near_left_side).any())

    @functools.cached_property
    def corners(self) -> Array:
        """Corners of the blocks, in order, (k, 4, 2) m."""
        x, y, _, half_length, half_width = self.blocks.T[..., None]
        ahead, left = half_length * (1, -1, -1, 1), half_width * (1, 1, -1, -1)
        cos, sin = (values[:, None] for values in self._directions)
        return np.stack((x + ahead * cos - left * sin, y + ahead * sin + left * cos), axis=-1)

    @functools.cached_property
    def _directions(self) -> tuple[Array, Array]:
        return np.cos(self.blocks[:, 2]), np.sin(self.blocks[:, 2])

    @property
    def _sizes(self) -> tuple[Array, Array]:
        return self.blocks[:, 3], self.blocks[:, 4]

    def _gaps(self) -> Array:
        """Return distances between blocks, (k, k); 0 where they overlap."""
        k, (half_x, half_y) = len(self.blocks), self._sizes
        x, y = (values.reshape(k, 4, k) for values in self._in_frames(self.corners.reshape(-1, 2)))
        apart = (np.abs(x).min(axis=1) > half_x) & ((x > 0).all(axis=1) | (x < 0).all(axis=1))
        apart |= (np.abs(y).min(axis=1) > half_y) & ((y > 0).all(axis=1) | (y < 0).all(axis=1))
        gaps = np.where(apart | apart.T, _to_boxes(x, y, half_x, half_y).min(axis=1), 0.0)
        return np.minimum(gaps, gaps.T)

    def _in_frames(self, points: Array) -> tuple[Array, Array]:
        """Return points (m, 2) in the frames of the blocks: x and y, (m, k)."""
        x, y = points[:, 0, None] - self.blocks[:, 0], points[:, 1, None] - self.blocks[:, 1]
        cos, sin = self._directions
        return x * cos + y * sin, y * cos - x * sin


def _to_boxes(x: Array, y: Array, half_x: Array, half_y: Array) -> Array:
    """Return distances of points to boxes, in the boxes' frames; negative inside."""
    x, y = np.abs(x) - half_x, np.abs(y) - half_y
    return np.asarray(np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0)) + np.minimum(np.maximum(x, y), 0.0))
