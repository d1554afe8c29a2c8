"""Minimum-time reaching of a pose: the search of `MinimumTimeReach`, from all branches of inverse kinematics.

A place is the end-effector's position and its three axes, scaled: 12 numbers in m. Distances of places are smooth in
the joints, without the singularity of rotation vectors at half a turn. With a scale of `lever` / sqrt(2), an angle
counts as `lever` (m/rad) times 2 sin(angle / 2).
"""

import functools
import math

import numpy as np

from armctl.core.arrays import Array
from armctl.kernels import reach
from armctl.kinematics.minimum_time_reach import LAST_STEP, MinimumTimeReach, MinimumTimeReachOptions
from armctl.kinematics.model import ArmModel

BRANCHES = 16
"""Configurations for a pose, at most: a UR has 8, arms of seven joints have circles of them."""
FIRST_STEP = 0.05
"""rad: joint step limit of the first linear program; a pose's ball is smaller than a position's."""
REFINEMENTS = np.array((0.05, 0.05, 0.03, 0.02, 0.0))
"""rad: joint step limit in each linear program of `times`."""
SHIFTS = np.concatenate([share * np.concatenate((np.eye(3), -np.eye(3))) for share in (0.5, 1.0)])
"""Shares of the radius, along the axes of a pose's own frame, of poses around it."""
EFFORT = MinimumTimeReachOptions(starts=0, refine_iterations=48)


class MinimumTimePose(MinimumTimeReach):
    """The search for one arm; centres are places (12,), and `radius` is a distance of places, m."""

    def __init__(self, model: ArmModel, lever: float) -> None:
        super().__init__(model, EFFORT)
        self.lever = lever
        self._max_steps = np.geomspace(FIRST_STEP, LAST_STEP, EFFORT.refine_iterations)

    def centre(self, position: Array, axes: Array) -> Array:
        """Return places (..., 12) m of positions (..., 3) m and the first two axes (..., 6), which may be inexact."""
        x, y = axes[..., :3], axes[..., 3:6]
        x = _unit(x)
        y = _unit(y - (x * y).sum(axis=-1, keepdims=True) * x)
        return np.concatenate((position, *(self._scale * axis for axis in (x, y, np.cross(x, y)))), axis=-1)

    def pose(self, centre: Array) -> Array:
        """Return the homogeneous (4, 4) pose of a place (12,), whose axes may be inexact."""
        pose = np.eye(4)
        pose[:3, 3] = centre[:3]
        pose[:3, :3] = self.centre(centre[:3], centre[3:9])[3:].reshape(3, 3).T / self._scale
        return pose

    def place(self, q: Array) -> Array:
        """Return the end-effector's place (12,) at q (dof,)."""
        pose = self.model.pose(q)
        return np.concatenate((pose[:3, 3], self._scale * pose[:3, :3].T.ravel()))

    def places(self, q: Array) -> Array:
        """Return the same of q (n, dof): (n, 12)."""
        return np.array([self.place(row) for row in q]).reshape(-1, 12)

    def place_jacobian(self, q: Array) -> Array:
        """Return the derivative of `place`, (12, dof) m/rad."""
        jacobian, axes = self.model.jacobian(q), self.place(q)[3:].reshape(3, 3)
        turned = np.cross(jacobian[3:].T, axes[:, None])  # (axes, dof, 3)
        return np.vstack((jacobian[:3], *turned.swapaxes(1, 2)))

    def closest(self, centre: Array, q: Array) -> Array:
        """Return the configuration (dof,) nearest to `q`, in collision or not, whose pose is nearest to `centre`."""
        return self.ik.pose(self.pose(centre), q).closest

    def around(self, centre: Array, radius: float) -> Array:
        """Return the same pose moved along the axes of its own frame, by shares of `radius` (m)."""
        steps = (radius * SHIFTS) @ self.pose(centre)[:3, :3].T
        return np.concatenate((centre[:3] + steps, np.tile(centre[3:], (len(steps), 1))), axis=1)

    def configurations(self, start: Array, centre: Array) -> Array:
        """Return configurations (k, dof) with the end-effector in the pose, in collision or not, near `start`."""
        return self.ik.pose(self.pose(centre), start, BRANCHES).solutions

    def at_centre(self, start: Array, centre: Array) -> Array:
        """Return collision-free configurations (k, dof) with the end-effector in the pose, the earliest first."""
        q = self._guesses(start, centre)
        return self._by_time(start, q[self.model.are_free(q)])

    def times(self, q: Array, velocity: Array, centres: Array, radius: float, goals: Array) -> Array:
        """Return the seconds (m,) from q (m, dof) with `velocity` (m, dof) rad/s to places `centres` (m, 12).

        `goals` (m, k, dof) are configurations there; NaN: there are no more. 0 within `radius` (m).
        """
        times = np.empty(len(q))
        q, velocity = np.ascontiguousarray(q), np.ascontiguousarray(velocity)
        reach.min_times_to_poses(self.model.joints, q, velocity, centres, radius, goals, REFINEMENTS, times)
        return times

    @functools.cached_property
    def _scale(self) -> float:
        return self.lever / math.sqrt(2)

    def _candidates(self, start: Array, centre: Array, radius: float, velocity: Array) -> tuple[Array, Array]:
        centre = self.centre(centre[:3], centre[3:9])
        if np.linalg.norm(self.place(start) - centre) <= radius:
            return start[None], np.zeros(1)
        q = self._guesses(start, centre)
        return self.refined(start, q + reach.BESIDE * (start - q), centre, radius, velocity)

    def _guesses(self, start: Array, centre: Array) -> Array:
        """Return the configurations (k, dof) of the pose within the limits, or the closest one if there is none."""
        result = self.ik.pose(self.pose(centre), start, BRANCHES)
        return result.solutions if result.reachable else result.closest[None]


def _unit(vectors: Array) -> Array:
    """Return vectors (..., 3) of length 1; a null vector stays one."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), np.finfo(float).tiny))
