"""Routes with corners, on which obstacles move back and forth."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels import routes as kernel
from armctl.scene.pedestrians import PedestrianTrajectories


@dataclass(frozen=True, eq=False)
class Routes(PedestrianTrajectories):
    """w obstacles, each moving back and forth on a polyline, along each segment at a speed of its own.

    `start` and `end` are the first and last corners, `speed` is the mean one, and `phase` is not used.
    """

    corners: Array
    """(..., w, k, 2), m."""
    times: Array
    """(..., w, k) s at which the obstacle is first at its corners, in order; the first may be below 0.

    A route with fewer corners than others repeats the last one."""

    @classmethod
    def through(cls, corners: Array, times: Array, radius: float) -> "Routes":
        """Return the obstacles of a `radius` (m) that are at `corners` (..., w, k, 2) m at `times` (..., w, k) s."""
        lengths = np.linalg.norm(np.diff(corners, axis=-2), axis=-1).sum(axis=-1)
        speed = lengths / (times[..., -1] - times[..., 0])
        return cls(corners[..., 0, :], corners[..., -1, :], speed, 0.0 * speed, radius, corners, times)

    @property
    def along(self) -> NDArray[np.bool_]:
        """(..., w) False: nobody stays in a lane along the bridge."""
        return np.zeros(np.shape(self.speed), dtype=bool)

    def across(self) -> "Routes":
        """Return all of them."""
        return self

    @property
    def lanes(self) -> Array:
        """(m, 4) m: both ends of all segments; for one bridge only."""
        ends = np.concatenate((self.corners[:, :-1], self.corners[:, 1:]), axis=-1).reshape(-1, 4)
        return np.asarray(ends[(ends[:, :2] != ends[:, 2:]).any(axis=1)])

    def moved_to(self, start: Array, end: Array) -> "Routes":
        """Return routes of the same shapes that begin at `start` (..., w, 2), m."""
        return replace(self, start=start, end=end, corners=self.corners + (start - self.start)[..., None, :])

    def positions_of_each(self, times: Array) -> Array:
        """Return positions (..., w, 2) m, of each obstacle at a time of its own, (..., w) s."""
        return self._motion(times)[0]

    def velocities_of_each(self, times: Array) -> Array:
        """Return velocities (..., w, 2) m/s, of each obstacle at a time of its own, (..., w) s."""
        return self._motion(times)[1]

    def _motion(self, times: Array) -> tuple[Array, Array]:
        shape = np.broadcast_shapes(np.shape(times), np.shape(self.speed))
        positions, velocities = np.empty((2, *shape, 2))
        *_, corners, _ = np.shape(self.corners)
        kernel.move(
            self.corners.reshape(-1, corners, 2), self.times.reshape(-1, corners),
            np.broadcast_to(times, shape).ravel(), positions.reshape(-1, 2), velocities.reshape(-1, 2),
        )  # fmt: skip
        return positions, velocities
