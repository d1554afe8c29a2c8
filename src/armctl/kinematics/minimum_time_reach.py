"""Minimum-time reaching: over all configurations with the end-effector in a sphere, the one that is reached earliest.

    min over q of  max_j travel_time_j(q_j - start_j)   subject to  |position(q) - centre| <= radius

The time and the place in the sphere are optimised together, from several starts: Levenberg-Marquardt into the sphere,
then sequential linear programming (Griffith and Stewart, "A nonlinear programming technique for the optimization of
continuous processing systems", Management Science 7, 1961). Each linear program has one constraint and bounds that grow
with the time. Its solution has a closed form: every joint moves as far as time allows, in the direction that helps.
`armctl.kernels.reach` does the arithmetic.
"""

import math
from dataclasses import dataclass

import numpy as np

from armctl.core.arrays import Array
from armctl.core.options import Count, Natural, Positive, options
from armctl.kernels import reach
from armctl.kinematics.ik import Ik
from armctl.kinematics.model import ArmModel
from armctl.robot_description.joint_profiles import fly_by_setpoint, trapezoidal_displacement

FIRST_STEP, LAST_STEP = 0.2, 0.0005
"""rad: joint step limits of the first and the last linear program, which is valid only nearby."""


@options
class MinimumTimeReachOptions:
    """Effort of the search."""

    starts: Natural = 48
    """Start configurations besides the current one: half of them around it, half anywhere."""
    spread: Positive = 1.5
    """rad: range of the start configurations around the current one."""
    approach_iterations: Natural = 10
    """Levenberg-Marquardt iterations from a start into the sphere."""
    refine_iterations: Count = 20
    """Linear programs that reduce the time."""
    path_spacing: Positive = 0.05
    """rad: distance between the configurations at which a path is checked for collisions."""
    rng_seed: Natural = 0


@options
class ThoroughReachOptions(MinimumTimeReachOptions):
    """More effort."""

    starts: Natural = 96
    refine_iterations: Count = 48


THOROUGH = ThoroughReachOptions()
"""Options for a lower bound on time: as good as a general solver's best from many starts."""


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
    """True if the path to `q` is free of collisions while the drives move to `command`."""


class MinimumTimeReach:
    """Minimum-time search for one arm; `centre` (3,) and `radius` of the target sphere are in m."""

    def __init__(self, model: ArmModel, options: MinimumTimeReachOptions | None = None) -> None:
        self.model = model
        self.options = options or MinimumTimeReachOptions()
        self.ik = Ik(model)
        rng, half = np.random.default_rng(self.options.rng_seed), self.options.starts // 2
        self._max_steps = np.geomspace(FIRST_STEP, LAST_STEP, self.options.refine_iterations)
        self._anywhere = model.random_configurations(rng, self.options.starts - half)
        self._around = rng.uniform(-self.options.spread, self.options.spread, (half, model.dof))

    def place(self, q: Array) -> Array:
        """Return where the end-effector is at q (dof,), as the search measures distances: (3,) m."""
        return self.model.position(q)

    def places(self, q: Array) -> Array:
        """Return the same of q (n, dof): (n, 3) m."""
        return self.model.positions(q)

    def place_jacobian(self, q: Array) -> Array:
        """Return the derivative of `place`, (3, dof) m/rad."""
        return self.model.jacobian(q)[:3]

    def closest(self, centre: Array, q: Array) -> Array:
        """Return the configuration (dof,) nearest to `q`, in collision or not, whose place is nearest to `centre`."""
        return self.ik.position(centre, q).closest

    def find(self, start: Array, centre: Array, radius: float) -> ReachGoal | None:
        """Return the earliest collision-free goal found from rest at `start` (dof,); if none is free, the earliest.

        None if no start led into the sphere.
        """
        candidates = self.candidates(start, centre, radius)
        goal = self._first_free(start, candidates)
        if goal is None:
            goal = self._first_free(start, self.at_centre(start, centre))
        return self._goal(start, candidates[0]) if goal is None and len(candidates) else goal

    def candidates(self, start: Array, centre: Array, radius: float) -> Array:
        """Return configurations (k, dof) in the sphere, in collision or not, those reached earliest from rest first."""
        return self._by_time(start, self._candidates(start, centre, radius, np.zeros(self.model.dof))[0])

    def around(self, centre: Array, radius: float) -> Array:
        """Return further places (k, m) within `radius` (m) of `centre` (m,), for goals where there is room; maybe none.

        A position has configurations in many orientations, and needs no others.
        """
        return np.zeros((0, len(centre)))

    def configurations(self, start: Array, centre: Array) -> Array:
        """Return configurations (k, dof) with the end-effector at `centre`, in collision or not, near `start`."""
        return self.model.nearest_turn(np.vstack(list(self.ik.configurations(centre))), start)

    def at_centre(self, start: Array, centre: Array) -> Array:
        """Return collision-free configurations (k, dof) with the end-effector at `centre`, the earliest first."""
        q = np.array(list(self.ik.free_configurations(centre))).reshape(-1, self.model.dof)
        return self._by_time(start, self.model.nearest_turn(q, start))

    def min_time(self, start: Array, centre: Array, radius: float, velocity: Array | None = None) -> float:
        """Return the seconds from `start` (dof,) with `velocity` (dof,) rad/s into the sphere without obstacles.

        The time is infinite if no start led into the sphere. With the options `THOROUGH`, no policy is faster.
        """
        moving = np.zeros(self.model.dof) if velocity is None else velocity
        return float(self._candidates(start, centre, radius, moving)[1].min(initial=np.inf))

    def _by_time(self, start: Array, goals: Array) -> Array:
        return np.asarray(goals[np.argsort(self.model.min_time(start, goals), kind="stable")])

    def _first_free(self, start: Array, q: Array) -> ReachGoal | None:
        goals = (self._goal(start, configuration) for configuration in q)
        return next((goal for goal in goals if goal.collision_free), None)

    def _goal(self, start: Array, q: Array) -> ReachGoal:
        time = float(self.model.min_time(start, q))
        command = fly_by_setpoint(start, q, time, self.model.limits)
        points = 1 + math.ceil(np.abs(q - start).max() / self.options.path_spacing)
        times = np.linspace(time, 0, points, endpoint=False)
        path = start + trapezoidal_displacement(times, command - start, self.model.limits)
        return ReachGoal(q, time, command, bool(self.model.are_free(path).all()))

    def _candidates(self, start: Array, centre: Array, radius: float, velocity: Array) -> tuple[Array, Array]:
        """Return early configurations (k, dof) in the sphere, and their times (k,): one from each start."""
        if np.linalg.norm(self.model.position(start) - centre) <= radius:
            return start[None], np.zeros(1)
        starts = np.vstack([start, start + self._around, self._anywhere])
        q = approach(self.model, starts, centre, self.options.approach_iterations)
        return self.refined(start, self.model.nearest_turn(q, start), centre, radius, velocity)

    def refined(
        self, start: Array, q: Array, centre: Array, radius: float, velocity: Array | float = 0.0
    ) -> tuple[Array, Array]:
        """Return configurations (k, dof) in the sphere, as early as possible, and their times (k,), s.

        There is one from each of q (n, dof) that led into it. `start` is (dof,), or (n, dof): one for each.
        """
        q, times = np.array(q, dtype=float), np.empty(len(q))
        count, dof = q.shape
        starts, velocities = _rows(start, count, dof), _rows(velocity, count, dof)
        centres = _rows(centre, count, np.shape(centre)[-1])
        reach.refine(self.model.joints, q, starts, centres, radius, velocities, self._max_steps, times)
        inside = np.isfinite(times)
        return q[inside], times[inside]


def approach(model: ArmModel, q: Array, centre: Array, iterations: int) -> Array:
    """Make Levenberg-Marquardt steps from q (n, dof) to `centre`, (3,) or (n, 3) m; return (n, dof)."""
    q = np.array(q, dtype=float)
    reach.approach(model.joints, q, _rows(centre, len(q), 3), iterations)
    return q


def _rows(values: Array | float, count: int, size: int) -> Array:
    """Return the same values (count, size) in each row, unless there are as many."""
    return np.ascontiguousarray(np.broadcast_to(values, (count, size)), dtype=float)
