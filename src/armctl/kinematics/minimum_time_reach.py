"""The soonest way to touch a sphere: over all configurations whose end-effector is in it, the least time to get there.

    min over q of  max_j travel_time_j(q_j - start_j)   subject to  |position(q) - centre| <= radius

The least time and the place in the sphere are found together, from several starts: Levenberg-Marquardt into the sphere,
then sequential linear programming (Griffith and Stewart, "A nonlinear programming technique for the optimization of
continuous processing systems", Management Science 7, 1961). Each linear programme, with one constraint and bounds that
grow with the time, has a solution in closed form: every joint goes as far as time allows, in the direction that helps.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.kinematics.ik import Ik
from armctl.kinematics.model import ArmModel
from armctl.robot_description.joint_profiles import (
    fly_by_setpoint,
    max_displacement,
    trapezoidal_displacement,
    travel_time,
)

Array = NDArray[np.float64]

LARGEST_APPROACH = 0.5
"""rad that a joint may move in one iteration of the approach."""
FIRST_STEP, LAST_STEP = 0.2, 0.0005
"""rad that a joint may move in the first and in the last linear programme, which holds only nearby."""
INSIDE = 5e-5
"""m that is aimed at inside the sphere: linear programmes end beside a curved surface."""
LEAST_SLOPE = 0.05
"""m/s: slower approaches are taken for that fast when the time is estimated from them."""
LARGEST_CHANGE = 0.1
"""s that an estimate of the time may change by at once."""


@dataclass(frozen=True)
class MinimumTimeReachOptions:
    """Effort of the search."""

    starts: int = 48
    """Besides where the arm is: half of them around it, half anywhere."""
    spread: float = 1.5
    """rad around where the arm is."""
    approach_iterations: int = 10
    """Steps from a start into the sphere."""
    refine_iterations: int = 20
    """Steps towards less time."""
    path_spacing: float = 0.05
    """rad between the points at which a path is tested for collisions."""
    rng_seed: int = 0


THOROUGH = MinimumTimeReachOptions(starts=96, refine_iterations=48)
"""For a lower bound on time: as good as a general solver's best from many starts."""


@dataclass(frozen=True)
class ReachGoal:
    """A way to touch the sphere."""

    q: Array
    """(dof,) where the end-effector enters the sphere, rad."""
    time: float
    """Seconds until the slowest joint is there, from rest."""
    command: Array
    """(dof,) joint positions to command: beyond `q` for joints that have no time to stop there."""
    collision_free: bool
    """Whether the way to `q` touches nothing, the drives moving to `command`."""


class MinimumTimeReach:
    """Finds ways to touch a sphere with one arm; `centre` (3,) and `radius` are in m."""

    def __init__(self, model: ArmModel, options: MinimumTimeReachOptions | None = None) -> None:
        self.model = model
        self.options = options or MinimumTimeReachOptions()
        self.ik = Ik(model)
        rng = np.random.default_rng(self.options.rng_seed)
        limits, half = model.limits, self.options.starts // 2
        low, high = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
        self._anywhere = rng.uniform(low, high, (self.options.starts - half, model.dof))
        self._around = rng.uniform(-self.options.spread, self.options.spread, (half, model.dof))

    def find(self, start: Array, centre: Array, radius: float) -> ReachGoal | None:
        """The soonest free way found from rest at `start` (dof,) into the sphere; if none is free, the soonest.

        None if the sphere was not reached from any start.
        """
        soonest = self._by_time(start, self._candidates(start, centre, radius))
        touch = self._first_free(start, soonest)
        if touch is None:
            at_centre = np.array(list(self.ik.free_configurations(centre))).reshape(-1, self.model.dof)
            touch = self._first_free(start, self._by_time(start, self.model.nearest_turn(at_centre, start)))
        return self._touch(start, soonest[0]) if touch is None and len(soonest) else touch

    def least_time(self, start: Array, centre: Array, radius: float, velocity: Array | None = None) -> float:
        """Seconds from `start` (dof,), moving with `velocity` (dof,), into the sphere, if nothing stood in the way.

        Infinite if the sphere was not reached from any start. With the options `THOROUGH`, no policy is sooner.
        """
        moving = np.zeros(self.model.dof) if velocity is None else velocity
        candidates = self._candidates(start, centre, radius, moving)
        return float(self._times(start, candidates, moving).min(initial=np.inf))

    def _times(self, start: Array, goals: Array, velocity: Array | float = 0.0) -> Array:
        return np.asarray(travel_time(goals - start, velocity, self.model.limits).max(axis=-1, initial=0.0))

    def _by_time(self, start: Array, goals: Array) -> Array:
        return np.asarray(goals[np.argsort(self._times(start, goals), kind="stable")])

    def _first_free(self, start: Array, goals: Array) -> ReachGoal | None:
        touches = (self._touch(start, goal) for goal in goals)
        return next((touch for touch in touches if touch.collision_free), None)

    def _touch(self, start: Array, q: Array) -> ReachGoal:
        time = float(self._times(start, q))
        command = fly_by_setpoint(start, q, time, self.model.limits)
        points = 1 + math.ceil(np.abs(q - start).max() / self.options.path_spacing)
        times = np.linspace(time, 0, points, endpoint=False)[:, None]
        way = start + trapezoidal_displacement(times, command - start, self.model.limits)
        return ReachGoal(
            q, time, command, collision_free=all(self.model.is_free(configuration) for configuration in way)
        )

    def _candidates(self, start: Array, centre: Array, radius: float, velocity: Array | float = 0.0) -> Array:
        """Configurations (k, dof) in the sphere, one from each start that got there, as soon as it could be made."""
        if np.linalg.norm(self.model.position(start) - centre) <= radius:
            return start[None]
        starts = np.vstack([start, start + self._around, self._anywhere])
        q = approach(self.model, starts, centre, self.options.approach_iterations)
        return self.sooner(start, self.model.nearest_turn(q, start), centre, radius, velocity)

    def sooner(self, start: Array, q: Array, centre: Array, radius: float, velocity: Array | float = 0.0) -> Array:
        """Configurations (k, dof) in the sphere, one from each of q (n, dof) that got there, as soon as it could be.

        `start` is (dof,), or (n, dof): one for each.
        """
        q = np.clip(q, self.model.limits.lower, self.model.limits.upper)
        best, best_time = q, np.full(len(q), np.inf)
        for largest_step in np.geomspace(FIRST_STEP, LAST_STEP, self.options.refine_iterations):
            step, time, distance = self.step(q, start, centre, radius, velocity, largest_step)
            better = (distance <= radius) & (time < best_time)
            best, best_time = np.where(better[:, None], q, best), np.where(better, time, best_time)
            q = q + step
        return np.asarray(best[np.isfinite(best_time)])

    def step(
        self, q: Array, start: Array, centre: Array, radius: float, velocity: Array | float, largest: float
    ) -> tuple[Array, Array, Array]:
        """The step (n, dof) of one linear programme from q (n, dof) on, of no joint more than `largest`, rad.

        And the times (n,) from `start` to q, s, and the distances (n,) at q from the spheres' centres, m. `centre` and
        `start` are one for all, or one for each.
        """
        position, jacobian = self.model.positions_and_jacobians(q)
        offset = centre - position
        distance = np.linalg.norm(offset, axis=-1, keepdims=True) + 1e-12
        time = self._times(start, q, velocity)
        gain = np.einsum("nij,ni->nj", jacobian, offset / distance)
        step = self._step(q, start, velocity, gain, distance - radius + INSIDE, time[:, None], largest)
        return step, time, distance[:, 0]

    def _step(
        self, q: Array, start: Array, velocity: Array | float, gain: Array, needed: Array, time: Array, largest: float
    ) -> Array:
        """Step (n, dof) that comes nearer to the sphere by `needed` (n, 1), in the least time from `start`.

        `gain` (n, dof) is how much nearer a joint's motion brings it, m/rad. The time is improved by Newton's method.
        Two steps of it are enough: solved to the end, programmes that hold only nearby overshoot.
        """
        limits, travel = self.model.limits, q - start
        sign = np.where(gain > 0, 1.0, -1.0)
        room = np.where(gain > 0, limits.upper - q, q - limits.lower)
        for _ in range(2):
            reach, speed = max_displacement(time, sign * velocity, limits)
            step = np.minimum(np.minimum(reach - sign * travel, room), largest)
            missing = needed - (np.abs(gain) * step).sum(axis=-1, keepdims=True)
            slope = (np.abs(gain) * speed * (step < largest)).sum(axis=-1, keepdims=True)
            change = np.clip(missing / np.maximum(slope, LEAST_SLOPE), -LARGEST_CHANGE, LARGEST_CHANGE)
            time = np.maximum(time + change, 1e-3)
        return np.asarray(sign * np.clip(step, -largest, largest))


def approach(model: ArmModel, q: Array, centre: Array, iterations: int) -> Array:
    """Configurations (n, dof) from which Levenberg-Marquardt has come nearer to `centre` (3,) than `q` (n, dof) are."""
    for _ in range(iterations):
        position, jacobian = model.positions_and_jacobians(q)
        error = centre - position
        damping = 0.5 * (error * error).sum(axis=-1) + 1e-6
        gram = jacobian @ jacobian.swapaxes(-1, -2) + damping[..., None, None] * np.eye(3)
        step = (jacobian.swapaxes(-1, -2) @ np.linalg.solve(gram, error[..., None]))[..., 0]
        largest = np.abs(step).max(axis=-1, keepdims=True)
        q = q + step * np.minimum(1.0, LARGEST_APPROACH / (largest + 1e-12))
    return q
