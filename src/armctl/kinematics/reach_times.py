"""The least times of many arms at once into spheres of their own: bounds on `MinimumTimeReach.least_time` from above.

Configurations are looked up by where their end-effector is, and the soonest of them from home are brought into the
sphere. They then stay the same wherever the arm goes, so that the time is one function of its state: to the best of
them, or straight into the sphere, improved by a few linear programmes. What stands in the way is not minded.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from armctl.kinematics.minimum_time_reach import MinimumTimeReach, approach
from armctl.kinematics.model import ArmModel
from armctl.robot_description.joint_profiles import travel_time

Array = NDArray[np.float64]

POSTURES = 30_000
"""Configurations, drawn uniformly, that spheres are looked up in."""
REFINEMENTS = (0.2, 0.13, 0.08, 0.05, 0.03, 0.02, 0.0)
"""rad that a joint may move in each linear programme."""
INSIDE = 0.9
"""Of a sphere's radius: the place in it that is nearest to the end-effector is taken to be so far from its centre."""
TIP_SPEED = 1.0
"""m/s with which the end-effector is expected to make up for what it is outside the sphere."""


@dataclass(frozen=True)
class ReachTimesOptions:
    """Effort for a sphere."""

    nearby: int = 256
    """Configurations with the end-effector nearest to it."""
    goals: int = 32
    """Of these, the soonest from home."""
    iterations: int = 3
    """Of Levenberg and Marquardt, from these into the sphere."""


@dataclass(frozen=True, eq=False)
class Spheres:
    """m spheres, each with configurations that have the end-effector in it."""

    centres: Array
    """(m, 3) m"""
    goals: Array
    """(m, goals, dof) rad"""
    excess: Array
    """(m, goals) s, for what the end-effector still is outside."""

    def put(self, ids: NDArray[np.integer[Any]], others: "Spheres") -> None:
        """Replace spheres `ids` by others."""
        for mine, theirs in zip(vars(self).values(), vars(others).values(), strict=True):
            mine[ids] = theirs

    def only(self, ids: NDArray[np.integer[Any]] | slice) -> "Spheres":
        """Spheres `ids`."""
        return Spheres(self.centres[ids], self.goals[ids], self.excess[ids])


class ReachTimes:
    """Least times of one kind of arm into spheres of `radius`, m."""

    def __init__(self, model: ArmModel, radius: float, effort: ReachTimesOptions | None = None) -> None:
        self.model, self.radius, self.effort = model, radius, effort or ReachTimesOptions()
        low, high = np.maximum(model.limits.lower, -np.pi), np.minimum(model.limits.upper, np.pi)
        postures = np.random.default_rng(0).uniform(low, high, (POSTURES, model.dof))
        self._postures = model.nearest_turn(postures, model.home)
        self._from_home = model.least_time(model.home, self._postures)
        self._touch = MinimumTimeReach(model)
        self._by_position = KDTree(model.positions(postures))

    def spheres(self, centres: Array) -> Spheres:
        """Spheres around `centres` (m, 3), m."""
        near = self._by_position.query(centres, self.effort.nearby)[1]
        soonest = np.argpartition(self._from_home[near], self.effort.goals, axis=1)[:, : self.effort.goals]
        postures = self._postures[np.take_along_axis(near, soonest, axis=1)]
        return Spheres(centres.copy(), *self._brought_to(postures, centres[:, None], centres[:, None]))

    def least(self, q: Array, velocity: Array, spheres: Spheres) -> Array:
        """Seconds (m,) from q (m, dof), moving with `velocity` (m, dof), rad/s, each into its sphere; 0 inside."""
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
        straight, excess = self._brought_to(q, nearest, spheres.centres)
        straight_time = self._times(q, velocity, straight, excess)
        goal = np.where((straight_time < time)[:, None], straight, goal)
        least = np.minimum(straight_time, time)
        for largest in REFINEMENTS:
            step, time, off = self._touch.step(goal, q, spheres.centres, self.radius, velocity, largest)
            goal = goal + step
            least = np.minimum(least, time + self._excess(off))
        return np.where(distance <= self.radius, 0.0, least)

    def _times(self, q: Array, velocity: Array, goals: Array, excess: Array) -> Array:
        return np.asarray(travel_time(goals - q, velocity, self.model.limits).max(axis=-1) + excess)

    def _brought_to(self, q: Array, places: Array, centres: Array) -> tuple[Array, Array]:
        """Configurations (..., dof) with the end-effector at `places`, from q (..., dof) on, or near them.

        And the time for what they are off the spheres around `centres`, s.
        """
        goals = approach(self.model, q, places, self.effort.iterations)
        goals = np.clip(goals, self.model.limits.lower, self.model.limits.upper)
        off = np.linalg.norm(self.model.positions(goals) - centres, axis=-1)
        return goals, self._excess(off)

    def _excess(self, distance: Array) -> Array:
        return np.maximum(distance - self.radius, 0.0) / TIP_SPEED
