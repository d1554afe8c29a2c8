"""Upper bounds on `MinimumTimeReach.least_time` for many arms at once, each with its own target sphere.

A few sampled configurations are moved into each sphere once. They stay the same wherever the arm goes, which makes the
time one function of the arm's state: the least over these configurations and the straight move into the sphere, refined
by a few linear programs. Obstacles are ignored.
"""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.core.options import options
from armctl.kernels import reach
from armctl.kinematics.model import ArmModel
from armctl.kinematics.reachability_map import ReachabilityMap

Array = NDArray[np.float64]

CONFIGURATIONS = 30_000
"""Size of the table in which spheres are looked up."""
REFINEMENTS = np.array((0.2, 0.13, 0.08, 0.05, 0.03, 0.02, 0.0))
"""rad: joint step limit in each linear program."""
INSIDE = 0.9
"""Fraction of the radius: the straight move aims at the sphere's nearest point at this distance from its centre."""
TIP_SPEED = 1.0
"""m/s: speed at which the end-effector is assumed to cover the remaining distance to the sphere."""


@options
class ReachTimesOptions:
    """Effort per sphere."""

    nearby: Annotated[int, Field(ge=2, le=CONFIGURATIONS)] = 256
    """Configurations with the end-effector nearest to the centre."""
    goals: Annotated[int, Field(ge=1)] = 32
    """Number of these, those reached earliest from home."""
    iterations: Annotated[int, Field(ge=0)] = 3
    """Levenberg-Marquardt iterations from these into the sphere."""


@dataclass(frozen=True, eq=False)
class Spheres:
    """m spheres, each with configurations that have the end-effector in it."""

    centres: Array
    """(m, 3) m"""
    goals: Array
    """(m, goals, dof) rad"""
    excess: Array
    """(m, goals) s: added time for goals whose end-effector is still outside."""

    def put(self, ids: NDArray[np.integer[Any]], others: "Spheres") -> None:
        """Replace spheres `ids` by others."""
        for mine, theirs in zip(vars(self).values(), vars(others).values(), strict=True):
            mine[ids] = theirs

    def only(self, ids: NDArray[np.integer[Any]] | slice) -> "Spheres":
        """Return the spheres `ids`."""
        return Spheres(self.centres[ids], self.goals[ids], self.excess[ids])


class ReachTimes:
    """Times of one kind of arm into spheres of `radius`, m."""

    def __init__(self, model: ArmModel, radius: float, effort: ReachTimesOptions | None = None) -> None:
        self.model, self.radius, self.effort = model, radius, effort or ReachTimesOptions()
        self._map = ReachabilityMap(model, CONFIGURATIONS, collision_free=False)
        self._near_home = model.nearest_turn(self._map.configurations, model.home)
        self._from_home = model.least_time(model.home, self._near_home)

    def spheres(self, centres: Array) -> Spheres:
        """Return spheres around `centres` (m, 3), m."""
        near = self._map.nearest(centres, self.effort.nearby)[1]
        earliest = np.argpartition(self._from_home[near], self.effort.goals, axis=1)[:, : self.effort.goals]
        goals = self._near_home[np.take_along_axis(near, earliest, axis=1)]
        excess = np.empty(goals.shape[:2])
        around = np.repeat(centres, self.effort.goals, axis=0)
        reach.move_to(
            self.model.joints, goals.reshape(-1, self.model.dof), around, around, self.radius, TIP_SPEED,
            self.effort.iterations, excess.ravel(),
        )  # fmt: skip
        return Spheres(centres.copy(), goals, excess)

    def min_times(self, q: Array, velocity: Array, spheres: Spheres) -> Array:
        """Return the seconds (m,) from q (m, dof) with `velocity` (m, dof) rad/s, each into its sphere; 0 inside."""
        times = np.empty(len(q))
        q, velocity = np.ascontiguousarray(q), np.ascontiguousarray(velocity)
        reach.least_times_into_spheres(
            self.model.joints, q, velocity, spheres.centres, spheres.goals, spheres.excess,
            self.radius, TIP_SPEED, INSIDE, self.effort.iterations, REFINEMENTS, times,
        )  # fmt: skip
        return times
