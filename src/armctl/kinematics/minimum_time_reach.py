"""Minimum-time reaching: over all configurations with the end-effector in a sphere, the one that is reached earliest.

    min over q of  max_j travel_time_j(q_j - start_j)   subject to  |position(q) - centre| <= radius

The time and the place in the sphere are optimised together, from several starts: Levenberg-Marquardt into the sphere,
then sequential linear programming (Griffith and Stewart, "A nonlinear programming technique for the optimization of
continuous processing systems", Management Science 7, 1961). Each linear program has one constraint and bounds that grow
with the time. Its solution has a closed form: every joint moves as far as time allows, in the direction that helps.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.kinematics.damped_least_squares import damped_step
from armctl.kinematics.ik import Ik
from armctl.kinematics.model import ArmModel
from armctl.options import options
from armctl.robot_description.joint_profiles import (
    fly_by_setpoint,
    max_displacement,
    trapezoidal_displacement,
    travel_time,
)

Array = NDArray[np.float64]

MAX_APPROACH_STEP = 0.5
"""rad: joint step limit in one iteration of `approach`."""
FIRST_STEP, LAST_STEP = 0.2, 0.0005
"""rad: joint step limits of the first and the last linear program, which is valid only nearby."""
INSIDE = 5e-5
"""m: depth inside the sphere that is aimed at, since linear programs end beside a curved surface."""
MIN_SLOPE = 0.05
"""m/s: lower bound on the approach speed when the time is estimated from it."""
MAX_TIME_CHANGE = 0.1
"""s: limit on one change of the time estimate."""


@options
class MinimumTimeReachOptions:
    """Effort of the search."""

    starts: Annotated[int, Field(ge=0)] = 48
    """Start configurations besides the current one: half of them around it, half anywhere."""
    spread: Annotated[float, Field(gt=0)] = 1.5
    """rad: range of the start configurations around the current one."""
    approach_iterations: Annotated[int, Field(ge=0)] = 10
    """Levenberg-Marquardt iterations from a start into the sphere."""
    refine_iterations: Annotated[int, Field(ge=1)] = 20
    """Linear programs that reduce the time."""
    path_spacing: Annotated[float, Field(gt=0)] = 0.05
    """rad: distance between the configurations at which a path is checked for collisions."""
    rng_seed: Annotated[int, Field(ge=0)] = 0


THOROUGH = MinimumTimeReachOptions(starts=96, refine_iterations=48)
"""For a lower bound on time: as good as a general solver's best from many starts."""


@dataclass(frozen=True)
class ReachGoal:
    """A configuration with the end-effector in the sphere, and how to get there."""

    q: Array
    """(dof,) rad: where the end-effector enters the sphere."""
    time: float
    """Seconds until the slowest joint is there, from rest."""
    command: Array
    """(dof,) rad: joint positions to command, beyond `q` for joints that have no time to stop there."""
    collision_free: bool
    """Whether the path to `q` is free of collisions while the drives move to `command`."""


class MinimumTimeReach:
    """Minimum-time search for one arm; `centre` (3,) and `radius` of the target sphere are in m."""

    def __init__(self, model: ArmModel, options: MinimumTimeReachOptions | None = None) -> None:
        self.model = model
        self.options = options or MinimumTimeReachOptions()
        self.ik = Ik(model)
        rng, half = np.random.default_rng(self.options.rng_seed), self.options.starts // 2
        self._anywhere = model.random_configurations(rng, self.options.starts - half)
        self._around = rng.uniform(-self.options.spread, self.options.spread, (half, model.dof))

    def find(self, start: Array, centre: Array, radius: float) -> ReachGoal | None:
        """The earliest collision-free goal found from rest at `start` (dof,); if none is free, the earliest.

        None if no start led into the sphere.
        """
        candidates = self._by_time(start, self._candidates(start, centre, radius))
        goal = self._first_free(start, candidates)
        if goal is None:
            at_centre = np.array(list(self.ik.free_configurations(centre))).reshape(-1, self.model.dof)
            goal = self._first_free(start, self._by_time(start, self.model.nearest_turn(at_centre, start)))
        return self._goal(start, candidates[0]) if goal is None and len(candidates) else goal

    def least_time(self, start: Array, centre: Array, radius: float, velocity: Array | None = None) -> float:
        """Seconds from `start` (dof,), moving with `velocity` (dof,) rad/s, into the sphere. Obstacles are ignored.

        Infinite if no start led into the sphere. With the options `THOROUGH`, no policy is faster.
        """
        moving = np.zeros(self.model.dof) if velocity is None else velocity
        candidates = self._candidates(start, centre, radius, moving)
        return float(self._times(start, candidates, moving).min(initial=np.inf))

    def _times(self, start: Array, goals: Array, velocity: Array | float = 0.0) -> Array:
        return np.asarray(travel_time(goals - start, velocity, self.model.limits).max(axis=-1, initial=0.0))

    def _by_time(self, start: Array, goals: Array) -> Array:
        return np.asarray(goals[np.argsort(self._times(start, goals), kind="stable")])

    def _first_free(self, start: Array, q: Array) -> ReachGoal | None:
        goals = (self._goal(start, one) for one in q)
        return next((goal for goal in goals if goal.collision_free), None)

    def _goal(self, start: Array, q: Array) -> ReachGoal:
        time = float(self._times(start, q))
        command = fly_by_setpoint(start, q, time, self.model.limits)
        points = 1 + math.ceil(np.abs(q - start).max() / self.options.path_spacing)
        times = np.linspace(time, 0, points, endpoint=False)[:, None]
        path = start + trapezoidal_displacement(times, command - start, self.model.limits)
        return ReachGoal(q, time, command, collision_free=all(map(self.model.is_free, path)))

    def _candidates(self, start: Array, centre: Array, radius: float, velocity: Array | float = 0.0) -> Array:
        """Configurations (k, dof) in the sphere: one, as early as possible, from each start that led into it."""
        if np.linalg.norm(self.model.position(start) - centre) <= radius:
            return start[None]
        starts = np.vstack([start, start + self._around, self._anywhere])
        q = approach(self.model, starts, centre, self.options.approach_iterations)
        return self.refined(start, self.model.nearest_turn(q, start), centre, radius, velocity)

    def refined(self, start: Array, q: Array, centre: Array, radius: float, velocity: Array | float = 0.0) -> Array:
        """Configurations (k, dof) in the sphere: one, as early as possible, from each of q (n, dof) that led into it.

        `start` is (dof,), or (n, dof): one for each.
        """
        q = np.clip(q, self.model.limits.lower, self.model.limits.upper)
        best, best_time = q, np.full(len(q), np.inf)
        for max_step in np.geomspace(FIRST_STEP, LAST_STEP, self.options.refine_iterations):
            step, time, distance = self.step(q, start, centre, radius, velocity, max_step)
            better = (distance <= radius) & (time < best_time)
            best, best_time = np.where(better[:, None], q, best), np.where(better, time, best_time)
            q = q + step
        return np.asarray(best[np.isfinite(best_time)])

    def step(
        self, q: Array, start: Array, centre: Array, radius: float, velocity: Array | float, max_step: float
    ) -> tuple[Array, Array, Array]:
        """One linear program at q (n, dof), with joint steps up to `max_step` (rad).

        Returns the step (n, dof), the times (n,) s from `start` to q, and the distances (n,) m at q from the sphere's
        centre. `centre` and `start` are one for all, or one for each.
        """
        position, jacobian = self.model.positions_and_jacobians(q)
        offset = centre - position
        distance = np.linalg.norm(offset, axis=-1, keepdims=True) + 1e-12
        time = self._times(start, q, velocity)
        gain = np.einsum("nij,ni->nj", jacobian, offset / distance)
        step = self._step(q, start, velocity, gain, distance - radius + INSIDE, time[:, None], max_step)
        return step, time, distance[:, 0]

    def _step(
        self, q: Array, start: Array, velocity: Array | float, gain: Array, needed: Array, time: Array, max_step: float
    ) -> Array:
        """Step (n, dof) that comes nearer to the sphere by `needed` (n, 1) m, in the least time from `start`.

        `gain` (n, dof) is the approach per joint motion, m/rad. Newton's method improves the time. Two of its steps are
        enough: programs solved to convergence overshoot, since they are valid only nearby.
        """
        limits, travel = self.model.limits, q - start
        sign = np.where(gain > 0, 1.0, -1.0)
        room = np.where(gain > 0, limits.upper - q, q - limits.lower)
        for _ in range(2):
            reach, speed = max_displacement(time, sign * velocity, limits)
            step = np.minimum(np.minimum(reach - sign * travel, room), max_step)
            missing = needed - (np.abs(gain) * step).sum(axis=-1, keepdims=True)
            slope = (np.abs(gain) * speed * (step < max_step)).sum(axis=-1, keepdims=True)
            change = np.clip(missing / np.maximum(slope, MIN_SLOPE), -MAX_TIME_CHANGE, MAX_TIME_CHANGE)
            time = np.maximum(time + change, 1e-3)
        return np.asarray(sign * np.clip(step, -max_step, max_step))


def approach(model: ArmModel, q: Array, centre: Array, iterations: int) -> Array:
    """Configurations (..., dof) after Levenberg-Marquardt iterations from q (..., dof) towards `centre` (..., 3) m."""
    for _ in range(iterations):
        position, jacobian = model.positions_and_jacobians(q)
        error = centre - position
        step = damped_step(jacobian, error, 0.5 * (error * error).sum(axis=-1) + 1e-6)
        largest = np.abs(step).max(axis=-1, keepdims=True)
        q = q + step * np.minimum(1.0, MAX_APPROACH_STEP / (largest + 1e-12))
    return q
