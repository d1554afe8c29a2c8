"""Nonlinear model predictive control of a robot that drives along a path, around obstacles and pedestrians.

Each control step solves the problem of `drive_nlp` from two guesses: the last plan, and the cheapest of a few drives
along or beside the path at constant speed. The solver finds a local optimum near a guess, so the guesses decide on
which side to pass somebody, and who goes first. The first velocity of the cheaper plan is the command.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.control.arc_path import ArcPath
from armctl.control.drive_nlp import CONTROLS, PEOPLE, PLANES, DriveMpcOptions, Solution, drive_nlp
from armctl.errors import ConfigurationError

__all__ = ["DriveMpc", "DriveMpcOptions", "DriveMpcResult"]

Array = NDArray[np.float64]
Nearest = Callable[[Array], Array]

SMOOTHING = 0.3
"""m: corners of the path are rounded over this length in both directions."""
SHARES = (1.0, 0.7, 0.4, 0.15, 0.0)
"""Fractions of the maximum speed for guesses."""
OFFSETS = (0.0, -0.7, 0.7)
"""m: lateral offsets from the path for guesses."""
SIDESTEP = 0.5
"""s: time constant with which guesses approach their offsets."""
SEARCH = 1.5
"""m: how far ahead of the last nearest point of the path the next is searched."""
NOWHERE = 100.0
"""m: offset at which missing obstacles and pedestrians are placed."""
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
    """Solver iterations for both guesses."""
    seconds: float

    @property
    def command(self) -> tuple[float, float]:
        """Linear (m/s) and angular velocity (rad/s) to command."""
        return float(self.velocities[0, 0]), float(self.velocities[0, 1])


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
        self._planned: Solution | None = None

    def decide(self, pose: ArrayLike, velocity: ArrayLike, people: ArrayLike | None = None) -> DriveMpcResult:
        """Commands for a pose x, y (m), yaw (rad) and a velocity, linear (m/s) and angular (rad/s).

        `people` (steps + 1, w, 2), m, are the positions of w pedestrians now and after each period. Raises
        `ConfigurationError` for arrays of another shape, and for numbers that are not finite or exceed `MAX_INPUT`.
        """
        begin, options = time.perf_counter(), self.options
        x, y, yaw = _checked("pose", pose, (3,))
        velocity = _checked("velocity", velocity, (2,))
        people = np.zeros((options.steps + 1, 0, 2)) if people is None else people
        people = _checked("people", people, (options.steps + 1, *np.shape(people)[1:2], 2))
        fastest = np.array((options.max_speed, options.max_turn_rate))
        start = np.array((x, y, yaw, *np.clip(velocity, (-options.max_reverse, -fastest[1]), fastest)))
        self.progress = float(self.path.nearest((x, y), self.progress, self.progress + SEARCH))

        guesses = [self._best_drive(start, people)]
        if self._planned is not None:
            guesses.append(self._shifted(start, self._planned))
        plans = [self._solve(start, people, *guess) for guess in guesses]
        self._planned = min((plan for plan in plans if plan.solved), key=lambda plan: plan.cost, default=None)
        iterations = sum(plan.iterations for plan in plans)
        if self._planned is None:
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
        plan = self._planned
        velocities = np.clip(plan.states[1:, 3:], (-options.max_reverse, -fastest[1]), fastest)
        return DriveMpcResult(
            velocities, plan.states[:, :3], plan.cost, float(plan.controls[1:, 2].max()), True, iterations,
            time.perf_counter() - begin,
        )  # fmt: skip

    def _solve(self, start: Array, people: Array, states: Array, controls: Array) -> Solution:
        arc = self.path.nearest(states[:, :2], self.progress - SEARCH, self._reach)
        middle, ahead = self._along(arc)
        plan = drive_nlp(self.options).solve(
            start,
            np.hstack((middle, ahead)),
            self._planes(states[:, :2], middle),
            _closest(PEOPLE, people, states[:, :2]),
            states,
            controls,
        )
        return Solution(plan.states, plan.controls, plan.cost - float(arc.sum()), plan.solved, plan.iterations)

    @property
    def _reach(self) -> float:
        options = self.options
        return self.progress + SEARCH + options.steps * options.period * options.max_speed

    def _along(self, arc: Array) -> tuple[Array, Array]:
        """Points (..., 2) of the path with rounded corners, and its directions there."""
        spread = SMOOTHING * np.linspace(-1, 1, 5)
        chord = self.path.points_at(arc + SMOOTHING) - self.path.points_at(arc - SMOOTHING)
        length = np.linalg.norm(chord, axis=-1, keepdims=True)
        return self.path.points_at(arc[..., None] + spread).mean(axis=-2), chord / np.maximum(length, 1e-9)

    def _planes(self, points: Array, refuge: Array) -> Array:
        """Half-planes (m, `PLANES`, 3) between points (m, 2) and obstacles; `refuge` replaces points inside one."""
        inside = np.linalg.norm(self._nearest(points) - points[:, None], axis=-1).min(axis=1, initial=np.inf) < 1e-3
        points = np.where(inside[:, None], refuge, points)
        closest = _closest(PLANES, self._nearest(points), points)
        offset = points[:, None] - closest
        normal = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9)
        return np.concatenate((normal, (normal * closest).sum(axis=-1, keepdims=True)), axis=-1)

    def _best_drive(self, start: Array, people: Array) -> tuple[Array, Array]:
        """States and controls of the cheapest drive along or beside the path at one speed."""
        options, clock = self.options, self.options.period * np.arange(self.options.steps + 1)
        wanted = np.repeat(np.array(SHARES) * options.max_speed, len(OFFSETS))[:, None]
        change = np.clip(wanted - start[3], -options.max_acceleration * clock, options.max_acceleration * clock)
        speed = start[3] + change
        arc = self.progress + np.cumsum(
            options.period * np.pad((speed[:, 1:] + speed[:, :-1]) / 2, ((0, 0), (1, 0))), 1
        )
        middle, ahead = self._along(arc)
        left = np.stack((-ahead[..., 1], ahead[..., 0]), axis=-1)
        offset = float(left[0, 0] @ (start[:2] - middle[0, 0]))
        goal = np.tile(OFFSETS, len(SHARES))[:, None]
        beside = goal + (offset - goal) * np.exp(-clock / SIDESTEP)
        points = middle + beside[..., None] * left

        distances = np.linalg.norm(self._nearest(points.reshape(-1, 2)) - points.reshape(-1, 1, 2), axis=-1)
        to_obstacles = distances.min(axis=-1, initial=np.inf).reshape(arc.shape) - options.clearance
        to_people = np.linalg.norm(points[:, :, None] - people, axis=-1).min(axis=-1, initial=np.inf) - options.distance
        intrusion = np.maximum(0.0, -np.minimum(to_obstacles, to_people))
        cost = (options.off_path * beside**2 - arc + options.intrusion * intrusion).sum(axis=1)

        best = int(cost.argmin())
        steps = np.diff(points[best], axis=0, append=points[best, -1:] + ahead[best, -1:])
        yaw = np.unwrap(np.concatenate((start[2:3], np.arctan2(steps[1:, 1], steps[1:, 0]))))
        turning = np.clip(np.gradient(yaw, options.period), -options.max_turn_rate, options.max_turn_rate)
        states = np.column_stack((points[best], yaw, speed[best], turning))
        states[0] = start
        return states, np.zeros((options.steps, CONTROLS))

    def _shifted(self, start: Array, plan: Solution) -> tuple[Array, Array]:
        """The last plan shifted by one period, extended with its last velocities."""
        last, period = plan.states[-1], self.options.period
        beyond = last + period * np.array((last[3] * np.cos(last[2]), last[3] * np.sin(last[2]), last[4], 0, 0))
        states = np.vstack((start, plan.states[2:], beyond))
        states[1:, 2] += 2 * np.pi * np.round((start[2] - plan.states[1, 2]) / (2 * np.pi))
        return states, np.vstack((plan.controls[1:], np.zeros(CONTROLS)))

    def _braking(self, start: Array) -> Array:
        options, clock = self.options, self.options.period * np.arange(1, self.options.steps + 1)[:, None]
        lost = np.array((options.max_acceleration, options.max_turn_acceleration)) * clock
        return np.asarray(np.sign(start[3:]) * np.maximum(0.0, np.abs(start[3:]) - lost))

    def _poses(self, start: Array, velocities: Array) -> Array:
        """Poses (steps + 1, 3) for velocities (steps, 2), each reached at the end of its period."""
        velocities = np.vstack((start[3:], velocities))
        distance, turn = (self.options.period * (velocities[1:] + velocities[:-1]) / 2).T
        yaw = start[2] + np.concatenate(([0.0], np.cumsum(turn)))
        middle = (yaw[1:] + yaw[:-1]) / 2
        steps = np.column_stack((distance * np.cos(middle), distance * np.sin(middle)))
        return np.column_stack((start[:2] + np.vstack((np.zeros(2), np.cumsum(steps, axis=0))), yaw))


def _closest(count: int, others: Array, points: Array) -> Array:
    """The `count` of others (m, k, 2) closest to points (m, 2), padded with points far away: (m, count, 2)."""
    order = np.argsort(np.linalg.norm(others - points[:, None], axis=-1), axis=1)[:, :count]
    closest = np.take_along_axis(others, order[..., None], axis=1)
    away = np.repeat(points[:, None] + NOWHERE, count - closest.shape[1], axis=1)
    return np.concatenate((closest, away), axis=1)


def _checked(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not (np.abs(array) <= MAX_INPUT).all():
        raise ConfigurationError(f"{name} should be an array {shape} of numbers within +-{MAX_INPUT:g}, not {value!r}")
    return array
