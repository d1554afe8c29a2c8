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

from armctl.kinematics.minimum_time_reach import MinimumTimeReach, approach
from armctl.kinematics.model import ArmModel
from armctl.kinematics.reachability_map import ReachabilityMap
from armctl.options import options
from armctl.robot_description.joint_profiles import travel_time

Array = NDArray[np.float64]

CONFIGURATIONS = 30_000
"""Size of the table in which spheres are looked up."""
REFINEMENTS = (0.2, 0.13, 0.08, 0.05, 0.03, 0.02, 0.0)
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
    """Of these, those reached earliest from home."""
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
        """Spheres `ids`."""
        return Spheres(self.centres[ids], self.goals[ids], self.excess[ids])


class ReachTimes:
    """Times of one kind of arm into spheres of `radius`, m."""

    def __init__(self, model: ArmModel, radius: float, effort: ReachTimesOptions | None = None) -> None:
        self.model, self.radius, self.effort = model, radius, effort or ReachTimesOptions()
        self._map = ReachabilityMap(model, CONFIGURATIONS, collision_free=False)
        self._near_home = model.nearest_turn(self._map.configurations, model.home)
        self._from_home = model.least_time(model.home, self._near_home)
        self._minimum_time = MinimumTimeReach(model)

    def spheres(self, centres: Array) -> Spheres:
        """Spheres around `centres` (m, 3), m."""
        near = self._map.nearest(centres, self.effort.nearby)[1]
        earliest = np.argpartition(self._from_home[near], self.effort.goals, axis=1)[:, : self.effort.goals]
        q = self._near_home[np.take_along_axis(near, earliest, axis=1)]
        return Spheres(centres.copy(), *self._moved_to(q, centres[:, None], centres[:, None]))

    def least(self, q: Array, velocity: Array, spheres: Spheres) -> Array:
        """Seconds (m,) from q (m, dof), moving with `velocity` (m, dof) rad/s, each into its sphere; 0 inside."""
        goals = self.model.nearest_turn(spheres.goals, q[:, None])
        times = self._times(q[:, None], velocity[:, None], goals, spheres.excess)
        best = times.argmin(axis=1)[:, None]
        goal, time = (
            np.take_along_axis(goals, best[..., None], axis=1)[:, 0],
            np.take_along_axis(times, best, axis=1)[:, 0],
        )
        offset = self.model.positions(q) - spheres.centres
        distance = np.linalg.norm(offset, axis=-1)
        nearest = spheres.centres + offset * (INSIDE * self.radius / np.maximum(distance, self.radius))[:, None]
        straight, excess = self._moved_to(q, nearest, spheres.centres)
        straight_time = self._times(q, velocity, straight, excess)
        goal = np.where((straight_time < time)[:, None], straight, goal)
        least = np.minimum(straight_time, time)
        for max_step in REFINEMENTS:
            step, time, distances = self._minimum_time.step(goal, q, spheres.centres, self.radius, velocity, max_step)
            goal = goal + step
            least = np.minimum(least, time + self._excess(distances))
        return np.where(distance <= self.radius, 0.0, least)

    def _times(self, q: Array, velocity: Array, goals: Array, excess: Array) -> Array:
        return np.asarray(travel_time(goals - q, velocity, self.model.limits).max(axis=-1) + excess)

    def _moved_to(self, q: Array, positions: Array, centres: Array) -> tuple[Array, Array]:
        """Configurations (..., dof) moved from q towards end-effector `positions`, and their excess, s."""
        goals = approach(self.model, q, positions, self.effort.iterations)
        goals = np.clip(goals, self.model.limits.lower, self.model.limits.upper)
        return goals, self._excess(np.linalg.norm(self.model.positions(goals) - centres, axis=-1))

    def _excess(self, distance: Array) -> Array:
        return np.maximum(distance - self.radius, 0.0) / TIP_SPEED
