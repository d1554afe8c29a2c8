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
from armctl.kernels import depth_scan as kernel

HOLE = -0.4
"""m: what is seen below is a hole."""
FLOOR_GATE = 0.25
"""m: a point that appears farther from the floor is not of the floor."""
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

    def scan(self, image: NDArray[Any]) -> DepthScan | None:
        """Return what an image shows; None for a lost one: black, or without a finite number."""
        depths = np.where(np.isfinite(image), image, 0.0).astype(float)
        if not (depths > kernel.MIN_DEPTH).any():
            return None
        pitch, noise = self._floor(depths)
        width, farthest = depths.shape[1], FARTHEST * self.camera.farthest
        columns = kernel.Columns(np.empty((width, 2)), np.empty((width, 2)), np.empty(width), np.empty(width))
        kernel.reduce(depths, self._rays(pitch), farthest, columns)
        offset = np.array((self.mount.ahead, 0.0))
        return DepthScan(columns.standing + offset, columns.tall + offset, columns.heights, columns.free, pitch, noise)

    def painted(self, image: NDArray[Any], scan: DepthScan) -> NDArray[Any]:
        """Return the image (height, width) without its noise: the floor, what stands on it, holes.

        Nothing above `kernel.STANDING` is painted.
        """
        rays = self._rays(scan.pitch)
        rise, ahead, above = rays.rise[:, None], rays.ahead[:, None], rays.above
        floor = np.where(rise < 0, above / np.maximum(-rise, 1e-6), np.inf)
        standing = (scan.standing[:, 0] - self.mount.ahead) / ahead
        is_standing = (standing < floor) & (above + standing * rise < kernel.STANDING[1])
        is_hole = above + image * rise < HOLE
        depths = np.where(is_standing, standing, np.where(is_hole, image, floor))
        return np.minimum(depths, self.camera.farthest).astype(image.dtype)

    def _rays(self, pitch: float) -> kernel.Rays:
        """Return the rays of the pixels at a pitch (rad)."""
        up, (cos, sin) = self.camera.up, (np.cos(pitch), np.sin(pitch))
        above = self.mount.above + self.mount.lift * max(self.camera.pitch - pitch, 0.0)
        return kernel.Rays(up * cos - sin, cos + up * sin, self.camera.sideways, above)

    def _floor(self, depths: Array) -> tuple[float, float]:
        """Return the pitch at which most of the lower image is floor, and the noise of its depths (m)."""
        rest, noise = self.camera.pitch, 0.0
        pitch = rest
        for gate in (FLOOR_GATE, FLOOR_GATE / 2):
            turn, distance = kernel.tilt(depths, self._rays(pitch), gate)
            if np.isnan(turn):
                break
            noise = MAD_TO_STD * distance
            pitch = float(np.clip(pitch + turn, rest - MAX_NOD, rest + MAX_NOD))
        return pitch, noise
