"""Things that stand on a floor in a depth image: their distance in each column, and which are taller than obstacles.

All that stands is taken for vertical, as a stixel is (Badino, Franke and Pfeiffer, The stixel world, DAGM 2009). The
median over the rows about the horizon suppresses noise. The camera nods when the robot accelerates; the nod is the
median of the angles at which the rows below see the floor.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.estimation.depth_ranges import DepthCamera

HORIZON, FLOOR = 0.2, (-0.6, -0.12)
"""Rises (m per m ahead) of the rows that see what stands, up or down, and of those that see the floor."""
MIN_DEPTH = 0.05
"""m: less is a lost pixel."""
STANDING = (0.12, 0.76)
"""Heights (m) between which what is seen is an obstacle."""
HOLE = -0.4
"""m: what is seen below is a hole."""
TALL = (0.9, 1.45)
"""Heights (m) of a person above all obstacles."""
FLOOR_GATE = 0.25
"""m: a point that appears farther from the floor is not of the floor."""
MIN_FLOOR_PIXELS, MIN_TALL_PIXELS = 40, 2
MAX_NOD = 0.15
"""rad."""
MAD_TO_STD = 1.4826
"""Standard deviation per median absolute deviation, of a normal distribution."""
FARTHEST = 0.97
"""Share of the camera's range from which on nothing is in sight."""


@dataclass(frozen=True)
class CameraMount:
    """A place of a camera on a robot, m."""

    ahead: float
    """Distance before the robot's centre."""
    above: float
    """Height above the floor at rest."""
    lift: float
    """Rise in m per rad that the nose rises: the distance from the rear axle, about which it does."""


@dataclass(frozen=True, eq=False)
class DepthScan:
    """Content of a depth image in each of its columns, in the robot's frame: x ahead, y left, m."""

    standing: Array
    """(width, 2): point of the nearest obstacle or person at the camera's height; NaN if there is none."""
    tall: Array
    """(width, 2): point of the nearest person; NaN if there is none."""
    heights: Array
    """(width,): height of `standing`."""
    free: Array
    """(width,): distance from the camera up to which nothing stands; 0 where nothing was measured."""
    pitch: float
    """Angle by which the camera looked down, rad."""
    noise: float
    """Standard deviation of depths, m: by how much the floor is not flat."""


class DepthScanner:
    """Reduces depth images (height, width) of one camera, m along its optical axis."""

    def __init__(self, camera: DepthCamera, mount: CameraMount) -> None:
        self.camera, self.mount = camera, mount
        self._up, self._sideways = camera.up[:, None], camera.sideways[None]

    def scan(self, image: NDArray[Any]) -> DepthScan | None:
        """Return what an image shows; None for a lost one: black, or without a finite number."""
        depths = np.where(np.isfinite(image), image, 0.0).astype(float)
        measured = depths > MIN_DEPTH
        if not measured.any():
            return None
        pitch, noise = self._floor(depths, measured)
        rise, ahead, above = self._rays(pitch)
        x, y, z = depths * ahead, depths * self._sideways, above + depths * rise
        farthest = FARTHEST * self.camera.farthest
        near = measured & (depths < farthest)
        level = np.abs(rise / ahead) < HORIZON
        standing = near & level & (z > STANDING[0]) & (z < STANDING[1])
        tall = near & (z > TALL[0]) & (z < TALL[1])
        tall &= tall.sum(axis=0) >= MIN_TALL_PIXELS
        points = _medians(x, y, standing)
        clear = np.where((measured & level & ~standing).any(axis=0), farthest, 0.0)
        ranges = np.linalg.norm(points, axis=1)
        offset = np.array((self.mount.ahead, 0.0))
        return DepthScan(
            points + offset, _medians(x, y, tall) + offset, _median(z, standing),
            np.where(np.isnan(ranges), clear, ranges), pitch, noise,
        )  # fmt: skip

    def painted(self, image: NDArray[Any], scan: DepthScan) -> NDArray[Any]:
        """Return the image (height, width) without its noise: the floor, what stands on it up to `STANDING`, holes.

        Nothing above is painted.
        """
        rise, ahead, above = self._rays(scan.pitch)
        floor = np.where(rise < 0, above / np.maximum(-rise, 1e-6), np.inf)
        standing = (scan.standing[:, 0] - self.mount.ahead) / ahead
        is_standing = (standing < floor) & (above + standing * rise < STANDING[1])
        is_hole = above + image * rise < HOLE
        depths = np.where(is_standing, standing, np.where(is_hole, image, floor))
        return np.minimum(depths, self.camera.farthest).astype(image.dtype)

    def _rays(self, pitch: float) -> tuple[Array, Array, float]:
        """Return rise and advance (height, 1) per m of depth, and the camera's height."""
        rise, ahead = self._up * np.cos(pitch) - np.sin(pitch), np.cos(pitch) + self._up * np.sin(pitch)
        return rise, ahead, self.mount.above + self.mount.lift * max(self.camera.pitch - pitch, 0.0)

    def _floor(self, depths: Array, measured: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the pitch at which most of the lower image is floor, and the noise of its depths (m)."""
        rest, noise = self.camera.pitch, 0.0
        pitch = rest
        for gate in (FLOOR_GATE, FLOOR_GATE / 2):
            rise, ahead, above = self._rays(pitch)
            slope = rise / ahead
            rows = ((slope > FLOOR[0]) & (slope < FLOOR[1]))[:, 0]
            z = above + (rise * depths)[rows]
            floor = measured[rows] & (np.abs(z) < gate)
            if floor.sum() < MIN_FLOOR_PIXELS:
                break
            angles = z / (above / -slope[rows])
            turn = float(np.median(angles[floor]))
            flat = (z + turn * above / slope[rows]) / rise[rows]
            noise = MAD_TO_STD * float(np.median(np.abs(flat[floor])))
            pitch = float(np.clip(pitch + turn, rest - MAX_NOD, rest + MAX_NOD))
        return pitch, noise


def _median(values: Array, chosen: NDArray[np.bool_]) -> Array:
    """Return the median of each column's chosen values; NaN where none is chosen."""
    count, columns = chosen.sum(axis=0), np.arange(values.shape[1])
    values = np.sort(np.where(chosen, values, np.inf), axis=0)
    middle = (values[np.maximum(count - 1, 0) // 2, columns] + values[count // 2, columns]) / 2
    return np.where(count > 0, middle, np.nan)


def _medians(x: Array, y: Array, chosen: NDArray[np.bool_]) -> Array:
    return np.column_stack((_median(x, chosen), _median(y, chosen)))
