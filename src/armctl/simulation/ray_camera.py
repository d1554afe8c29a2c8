"""A camera that casts one ray per pixel, in all worlds at once, without a graphics library.

Scenes of convex shapes are seen by `armctl.kernels.rays`, which tries only the rays that can hit a shape; all others by
MuJoCo's own rays, which are the same, but slower.
"""

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels import rays
from armctl.simulation.ray_shapes import ray_shapes
from armctl.simulation.simulation import Simulation, WorldIds

MIN_ENVS_FOR_THREADS = 16
"""A thread is worth its while from so many worlds on."""


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
        at = simulation.model.camera(camera).id
        self._positions, self._rotations = (simulation.array(name)[:, at] for name in ("cam_xpos", "cam_xmat"))
        self._geoms = simulation.array("geom_xpos"), simulation.array("geom_xmat")
        self._geom_groups = np.ones(mujoco.mjNGROUP, dtype=np.uint8)
        self._geom_groups[list(hidden_groups)] = 0
        self._rays = pixel_rays(resolution, field_of_view)
        self._directions = self._rays[0, :, 0].copy(), self._rays[:, 0, 1].copy()
        self._shapes = ray_shapes(simulation.model, self._visible_geoms())
        self._pool = ThreadPoolExecutor(simulation.threads)

    def depth(self, furthest: float, ids: WorldIds | None = None) -> NDArray[np.float32]:
        """Return the distance along the optical axis, (n, height, width) m, at most `furthest`."""
        return np.minimum(self._cast(ids)[0], furthest).astype(np.float32)

    def classes(self, class_of_geom: NDArray[np.uint8], sky: int, ids: WorldIds | None = None) -> NDArray[np.uint8]:
        """Return the class of each pixel's geom, (n, height, width); `sky` for rays that hit nothing."""
        _, geoms = self._cast(ids)
        return np.where(geoms < 0, np.uint8(sky), class_of_geom[geoms])

    def _cast(self, ids: WorldIds | None) -> tuple[Array, NDArray[np.int32]]:
        """Return depths, and the ids of the geoms hit, (n, height, width): infinite and -1 for misses."""
        worlds = np.arange(self._simulation.n, dtype=np.int32) if ids is None else ids
        shape = (len(worlds), *self._rays.shape[:2])
        if self._shapes is None:
            return self._cast_by_mujoco(worlds, shape)
        shapes, depths, hits = self._shapes, np.empty(shape), np.empty(shape, dtype=np.int32)
        sizes, boxes = (self._simulation.field(name) for name in ("geom_size", "geom_aabb"))
        geoms = rays.Geoms(sizes, boxes, *self._geoms)
        pixel = self._rays[0, 1, 0] - self._rays[0, 0, 0]
        cameras = rays.Cameras(self._positions, self._rotations, *self._directions, pixel)

        def cast(part: slice) -> None:
            rays.cast_all(worlds[part], shapes, geoms, cameras, depths[part], hits[part])

        parts = min(self._simulation.threads, max(1, len(worlds) // MIN_ENVS_FOR_THREADS))
        ends = [len(worlds) * part // parts for part in range(parts + 1)]
        spans = [slice(*span) for span in itertools.pairwise(ends)]
        if parts == 1:
            cast(spans[0])
        else:
            list(self._pool.map(cast, spans))
        return depths, hits

    def _cast_by_mujoco(self, worlds: WorldIds, shape: tuple[int, ...]) -> tuple[Array, NDArray[np.int32]]:
        rotations = self._rotations[worlds].reshape(-1, 3, 3)
        # Rays have length 1 along the optical axis, so distances in ray lengths are depths.
        rays = self._rays.reshape(-1, 3) @ rotations.transpose(0, 2, 1)
        depths, geoms = self._simulation.cast_rays(self._positions[worlds][:, None], rays, self._geom_groups, worlds)
        return np.where(depths < 0, np.inf, depths).reshape(shape), geoms.reshape(shape)

    def _visible_geoms(self) -> list[int]:
        model = self._simulation.model
        materials = np.append(model.mat_rgba[:, 3], 1.0)  # the last is that of geoms without a material
        opacity = np.where(model.geom_matid < 0, model.geom_rgba[:, 3], materials[model.geom_matid])
        return np.flatnonzero(self._geom_groups[model.geom_group].astype(bool) & (opacity > 0)).tolist()


def pixel_rays(resolution: tuple[int, int], field_of_view: float) -> Array:
    """Return rays (height, width, 3) through pixel centres, in the camera's frame: x right, y up, z = -1."""
    width, height = resolution
    pixel = 2 * np.tan(np.radians(field_of_view) / 2) / width
    right = (np.arange(width) + 0.5 - width / 2) * pixel
    up = (height / 2 - np.arange(height) - 0.5) * pixel
    return np.stack(np.broadcast_arrays(right, up[:, None], -1.0), axis=-1)


def vertical_field_of_view(resolution: tuple[int, int], field_of_view: float) -> float:
    """Return the vertical field of view for a horizontal one, degrees."""
    width, height = resolution
    return float(np.degrees(2 * np.arctan(np.tan(np.radians(field_of_view) / 2) * height / width)))
