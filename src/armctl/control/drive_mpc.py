"""Nonlinear model predictive control of a robot that drives along a path, around obstacles and pedestrians.

Each control step solves the problem of `drive_nlp` near the last plan. The solver finds a local optimum near its guess,
which decides on which side to pass a pedestrian, and who goes first. So it looks for another plan too, near the
cheapest of a few drives along or beside the path at constant speed, unless that leads to the same plan. While the
cheapest drive stays the same, that search goes on from one control step to the next. The first velocity of the cheaper
plan is the command.
"""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armctl.control.arc_path import ArcPath
from armctl.control.drive_limits import DriveLimits
from armctl.control.drive_nlp import CONTROLS, STATES, DriveMpcOptions, DriveSolver, Solution, drive_nlp
from armctl.core.arrays import Array, checked_array
from armctl.kernels import drive_mpc as kernel

__all__ = ["DriveMpc", "DriveMpcOptions", "DriveMpcResult"]

Nearest = Callable[[Array], Array]

SHARES = np.array((1.0, 0.7, 0.4, 0.15, 0.0))
"""Fractions of the maximum speed for guesses."""
OFFSETS = np.array((0.0, -0.7, 0.7))
"""m: lateral offsets from the path for guesses."""
SEARCH = 1.5
"""m: how far ahead of the last nearest point of the path the next is searched."""
APART = 0.2
"""m: two plans or drives are alike if they are never farther apart at the same time."""
MAX_INPUT = 1e4
"""m, rad: limit on all inputs; with much larger numbers, Fatrop does not terminate."""


@dataclass(frozen=True, eq=False)
class DriveMpcResult:
    """The result of a control step; a failure is a result that brakes."""

    velocities: Array
    """Linear (m/s) and angular velocity (rad/s) of each predicted step, (steps, 2); the first is the command."""
    poses: Array
    """Predicted x, y (m) and yaw (rad), starting with the current pose, (steps + 1, 3)."""
    cost: float
    """Cost of the plan; infinite for a failure."""
    intrusion: float
    """m: largest violation of a clearance along the plan."""
    solved: bool
    iterations: int
    """Solver iterations for all guesses."""
    seconds: float

    @property
    def command(self) -> tuple[float, float]:
        """Linear (m/s) and angular velocity (rad/s) to command."""
        return float(self.velocities[0, 0]), float(self.velocities[0, 1])


@dataclass(frozen=True, eq=False)
class _Search:
    """A search for another plan: the drive where it began, and its current knots."""

    drive: Array
    knots: Array


class DriveMpc:
    """Drives along one path (m, 2), m, past static obstacles.

    `nearest` returns the point of each convex obstacle nearest to each of points (m, 2): (m, k, 2), m.
    Raises `ConfigurationError` for an invalid path.
    """

    def __init__(self, path: ArrayLike, nearest: Nearest, options: DriveMpcOptions | None = None) -> None:
        self.options = options or DriveMpcOptions()
        self.path = ArcPath(path)
        self.progress = 0.0
        """Arc length (m) of the path's point nearest to the robot; it never decreases."""
        self.failures = 0
        """Control steps without a solution."""
        self._nearest = nearest
        self._planned: Array | None = None
        self._search: _Search | None = None
        self._solvers = {kind: DriveSolver(self.options, *kind) for kind in drive_nlp(self.options).functions}
        self._limits: DriveLimits | None = None
        self._limited, self._numbers = self.options, self._kernel_options(self.options)

    def limit(self, limits: DriveLimits) -> None:
        """Keep these limits from now on, where they are lower than the options'."""
        values = {name: min(value, getattr(self.options, name, value)) for name, value in asdict(limits).items()}
        if (lowered := DriveLimits(**values)) != self._limits:
            clearance = self.options.clearance + values.pop("margin")
            self._limits, self._limited = lowered, replace(self.options, **values, clearance=clearance)
            self._numbers = self._kernel_options(self._limited)

    def decide(self, pose: ArrayLike, velocity: ArrayLike, people: ArrayLike | None = None) -> DriveMpcResult:
        """Return commands for a pose x, y (m), yaw (rad) and a velocity, linear (m/s) and angular (rad/s).

        `people` (steps + 1, w, 2), m, are the positions of w pedestrians now and after each period. Raises
        `ConfigurationError` for arrays of another shape, and for numbers that are not finite or exceed `MAX_INPUT`.
        """
        begin, options = time.perf_counter(), self.options
        x, y, yaw = checked_array("pose", pose, (3,), MAX_INPUT)
        velocity = checked_array("velocity", velocity, (2,), MAX_INPUT)
        people = np.zeros((options.steps + 1, 0, 2)) if people is None else people
        people = checked_array("people", people, (options.steps + 1, *np.shape(people)[1:2], 2), MAX_INPUT)
        fastest = np.array((options.max_speed, options.max_turn_rate))
        start = np.array((x, y, yaw, *np.clip(velocity, (-options.max_reverse, -fastest[1]), fastest)))
        self.progress = float(self.path.nearest((x, y), self.progress, self.progress + SEARCH))

        plans = self._plans(start, people)
        plan = min((plan for plan in plans if plan.solved), key=lambda plan: plan.cost, default=None)
        self._planned = plan.knots if plan else None
        iterations = sum(plan.iterations for plan in plans)
        if plan is None:
            self.failures += 1
            velocities = self._braking(start)
            return DriveMpcResult(
                velocities,
                self._poses(start, velocities),
                np.inf,
                np.nan,
                False,
                iterations,
                time.perf_counter() - begin,
            )
        velocities = np.clip(plan.knots[1:, 3:STATES], (-options.max_reverse, -fastest[1]), fastest)
        return DriveMpcResult(
            velocities, plan.knots[:, :3], plan.cost, float(plan.knots[1:-1, -1].max()), True, iterations,
            time.perf_counter() - begin,
        )  # fmt: skip

    def _plans(self, start: Array, people: Array) -> list[Solution]:
        """Return the plan near the last one, and another if there may be a better."""
        drive, plans = self._best_drive(start, people), []
        if self._planned is not None:
            plans = [self._solve(start, people, self._shifted(start, self._planned), near=True)]
        if plans and plans[0].solved:
            return plans + self._other_plans(start, people, drive, plans[0])
        self._search = None
        return [*plans, self._solve(start, people, drive)]

    def _other_plans(self, start: Array, people: Array, drive: Array, plan: Solution) -> list[Solution]:
        """Return a plan near a drive; none if that leads to the same plan."""
        guess, search, goes_on, self._search = drive, self._search, False, None
        if _are_close(drive, plan.knots):
            return []
        if search and _are_close(drive, self._shifted(start, search.drive)):
            guess, goes_on = self._shifted(start, search.knots), True
            if _are_close(guess, plan.knots):
                self._search = _Search(drive, plan.knots)
                return []
        other = self._solve(start, people, guess, near=goes_on, brief=True)
        if (np.abs(other.knots) <= MAX_INPUT).all():
            self._search = _Search(drive, other.knots)
        return [other]

    def _shifted(self, start: Array, knots: Array) -> Array:
        """Return the knots one period later."""
        shifted = np.empty_like(knots)
        kernel.shift(start, knots, self.options.period, shifted)
        return shifted

    def _solve(self, start: Array, people: Array, knots: Array, near: bool = False, brief: bool = False) -> Solution:
        """Return the plan near a guess: each of its positions is kept away from the nearest obstacles."""
        solver, points, options = self._solvers[near, brief], knots[:, :2].copy(), self.options
        reach = options.steps * options.period * self._limited.max_speed
        arcs = self.path.nearest(points, self.progress - SEARCH, self.progress + SEARCH + reach)
        kernel.follow_path(self.path.segments, arcs, solver.reference)
        kernel.choose_people(points, people, solver.people)
        obstacles = self._obstacles(points)
        if kernel.leave_obstacles(points, obstacles, solver.reference):
            obstacles = self._obstacles(points)
        kernel.separate(points, obstacles, solver.planes)
        solver.start[:], solver.knots[:] = start, knots
        if self._limits:
            solver.limit(self._limits)
        plan = solver.solve()
        return replace(plan, cost=plan.cost - float(arcs.sum()))

    def _best_drive(self, start: Array, people: Array) -> Array:
        """Return the knots of the cheapest drive along or beside the path at one speed."""
        numbers, steps, speeds = self._numbers, self.options.steps, SHARES * self._limited.max_speed
        points = np.empty((len(speeds), len(OFFSETS), steps + 2, 2))
        costs, knots = np.empty(points.shape[:2]), np.empty((steps + 1, STATES + CONTROLS))
        kernel.drive_beside(numbers, self.path.segments, start, self.progress, speeds, OFFSETS, points, costs)
        drives = points.reshape(-1, steps + 2, 2)
        obstacles = self._obstacles(points.reshape(-1, 2)).reshape(*drives.shape[:2], -1, 2)
        kernel.intrude(numbers, drives, obstacles, people, costs.reshape(-1))
        best = int(costs.argmin())
        kernel.drive_through(numbers, start, speeds[best // len(OFFSETS)], drives[best], knots)
        return knots

    def _kernel_options(self, options: DriveMpcOptions) -> Any:
        return np.array(tuple(getattr(options, name) for name in kernel.NAMES), kernel.OPTIONS)[()]

    def _obstacles(self, points: Array) -> Array:
        return np.ascontiguousarray(self._nearest(points), dtype=float)

    def _braking(self, start: Array) -> Array:
        options, clock = self._limited, self.options.period * np.arange(1, self.options.steps + 1)[:, None]
        lost = np.array((options.max_acceleration, options.max_turn_acceleration)) * clock
        return np.asarray(np.sign(start[3:]) * np.maximum(0.0, np.abs(start[3:]) - lost))

    def _poses(self, start: Array, velocities: Array) -> Array:
        """Return poses (steps + 1, 3) for velocities (steps, 2), each reached at the end of its period."""
        velocities = np.vstack((start[3:], velocities))
        distance, turn = (self.options.period * (velocities[1:] + velocities[:-1]) / 2).T
        yaw = start[2] + np.concatenate(([0.0], np.cumsum(turn)))
        middle = (yaw[1:] + yaw[:-1]) / 2
        steps = np.column_stack((distance * np.cos(middle), distance * np.sin(middle)))
        return np.column_stack((start[:2] + np.vstack((np.zeros(2), np.cumsum(steps, axis=0))), yaw))


def _are_close(first: Array, second: Array) -> bool:
    return bool(kernel.farthest_apart(first, second) <= APART)
