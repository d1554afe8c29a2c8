"""Upper bounds on `MinimumTimeReach.min_time` for many arms at once, each with its own target sphere.

A few sampled configurations are moved into each sphere once. They stay the same wherever the arm goes, which makes the
time one function of the arm's state: the least over these configurations and the straight move into the sphere, refined
by a few linear programs. Obstacles are ignored.
"""

from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from armctl.core.arrays import Array
from armctl.core.options import Count, Natural, options
from armctl.kernels import reach
from armctl.kernels.reach import Spheres
from armctl.kinematics.model import ArmModel
from armctl.kinematics.reachability_map import ReachabilityMap

CONFIGURATIONS = 30_000
"""Size of the table in which spheres are looked up."""
REFINEMENTS = np.array((0.2, 0.13, 0.08, 0.05, 0.03, 0.02, 0.0))
"""rad: joint step limit in each linear program."""


@options
class ReachTimesOptions:
    """Effort per sphere."""

    nearby: Annotated[int, Ge(2), Le(CONFIGURATIONS)] = 256
    """Configurations with the end-effector nearest to the centre."""
    goals: Count = 32
    """Number of these, those reached earliest from home."""
    iterations: Natural = 3
    """Levenberg-Marquardt iterations from these into the sphere."""


class ReachTimes:
    """Times of one kind of arm into spheres of `radius`, m."""

    def __init__(self, model: ArmModel, radius: float, effort: ReachTimesOptions | None = None) -> None:
        self.model, self.radius, self.effort = model, radius, effort or ReachTimesOptions()
        self._map = ReachabilityMap(model, CONFIGURATIONS, collision_free=False)
        self._near_home = model.nearest_turn(self._map.configurations, model.home)
        self._from_home = model.min_time(model.home, self._near_home)

    def spheres(self, centres: Array) -> Spheres:
        """Return spheres around `centres` (m, 3), m."""
        near = self._map.nearest(centres, self.effort.nearby)[1]
        earliest = np.argpartition(self._from_home[near], self.effort.goals, axis=1)[:, : self.effort.goals]
        goals = self._near_home[np.take_along_axis(near, earliest, axis=1)]
        excess = np.empty(goals.shape[:2])
        around = np.repeat(centres, self.effort.goals, axis=0)
        reach.move_to(
            self.model.joints, goals.reshape(-1, self.model.dof), around, around, self.radius, self.effort.iterations,
            excess.ravel(),
        )  # fmt: skip
        return Spheres(centres.copy(), goals, excess)

    def min_times(self, q: Array, velocity: Array, spheres: Spheres) -> Array:
        """Return the seconds (m,) from q (m, dof) with `velocity` (m, dof) rad/s, each into its sphere; 0 inside."""
        times = np.empty(len(q))
        q, velocity = np.ascontiguousarray(q), np.ascontiguousarray(velocity)
        reach.min_times_into_spheres(
            self.model.joints, q, velocity, spheres, self.radius, self.effort.iterations, REFINEMENTS, times
        )
        return times
