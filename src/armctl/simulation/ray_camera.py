"""A camera that casts one ray per pixel, in all worlds at once, without a graphics library."""

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.simulation.simulation import Array, Simulation, WorldIds


class RayCamera:
    """Images of an MJCF camera, without the geoms of `hidden_groups`.

    `resolution` is (width, height) in pixels, `field_of_view` the horizontal angle, degrees.
    """

    def __init__(
        self,
        simulation: Simulation,
        camera: str,
        resolution: tuple[int, int],
        field_of_view: float,
        hidden_groups: Sequence[int],
    ) -> None:
        self._simulation = simulation
        self._camera = simulation.model.camera(camera).id
        self._positions = simulation.array("cam_xpos")
        self._rotations = simulation.array("cam_xmat")
        self._shown = np.ones(mujoco.mjNGROUP, dtype=np.uint8)
        self._shown[list(hidden_groups)] = 0
        self._shape = (resolution[1], resolution[0])
        self._rays = pixel_rays(resolution, field_of_view).reshape(-1, 3)

    def depth(self, furthest: float, ids: WorldIds | None = None) -> NDArray[np.float32]:
        """Distance along the optical axis, (n, height, width) m, at most `furthest`."""
        hit, _ = self._cast(ids)
        return np.where(hit < 0, furthest, np.minimum(hit, furthest)).astype(np.float32)

    def classes(self, class_of_geom: NDArray[np.uint8], sky: int, ids: WorldIds | None = None) -> NDArray[np.uint8]:
        """Class of each pixel's geom, (n, height, width); `sky` for rays that hit nothing."""
        _, geoms = self._cast(ids)
        return np.where(geoms < 0, np.uint8(sky), class_of_geom[geoms])

    def _cast(self, ids: WorldIds | None) -> tuple[Array, NDArray[np.int32]]:
        worlds = slice(None) if ids is None else ids
        starts = self._positions[worlds, self._camera]
        rotations = self._rotations[worlds, self._camera].reshape(-1, 3, 3)
        # Rays have length 1 along the optical axis, so distances in ray lengths are depths.
        rays = self._rays @ rotations.transpose(0, 2, 1)
        depth, geoms = self._simulation.cast_rays(starts[:, None], rays, self._shown, ids)
        return depth.reshape(-1, *self._shape), geoms.reshape(-1, *self._shape)


def pixel_rays(resolution: tuple[int, int], field_of_view: float) -> Array:
    """Rays (height, width, 3) through pixel centres, in the camera's frame: x right, y up, z = -1."""
    width, height = resolution
    pixel = 2 * np.tan(np.radians(field_of_view) / 2) / width
    right = (np.arange(width) + 0.5 - width / 2) * pixel
    up = (height / 2 - np.arange(height) - 0.5) * pixel
    return np.stack(np.broadcast_arrays(right, up[:, None], -1.0), axis=-1)


def vertical_field_of_view(resolution: tuple[int, int], field_of_view: float) -> float:
    """The vertical field of view for a horizontal one, degrees."""
    width, height = resolution
    return float(np.degrees(2 * np.arctan(np.tan(np.radians(field_of_view) / 2) * height / width)))
