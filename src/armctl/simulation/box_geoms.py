"""Boxes whose sizes differ between worlds, and between episodes."""

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.simulation.simulation import Simulation, WorldIds

ABSENT_HALF_SIZE = 0.1
"""m, of boxes that are absent: MuJoCo's have a size."""


class BoxGeoms:
    """The box `geoms` (k,) of n worlds."""

    def __init__(self, simulation: Simulation, geoms: NDArray[np.int64]) -> None:
        self._geoms = geoms
        self._sizes, self._bounds, self._radii = (
            simulation.per_world(name) for name in ("geom_size", "geom_aabb", "geom_rbound")
        )

    def resize(self, ids: WorldIds, half_sizes: Array) -> None:
        """Set the boxes' half sizes (len(ids), k, 3) m in worlds `ids`; with a 0 among its own, a box is absent."""
        present, worlds = (half_sizes > 0).all(axis=-1, keepdims=True), ids[:, None]
        half_sizes = np.where(present, half_sizes, ABSENT_HALF_SIZE)
        self._sizes[worlds, self._geoms] = self._bounds[worlds, self._geoms, 3:] = half_sizes
        self._radii[worlds, self._geoms] = np.linalg.norm(half_sizes, axis=-1)
