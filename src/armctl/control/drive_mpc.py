"""Nonlinear model predictive control of a robot that drives along a path, around people and out of their way.

Each decision solves the problem of `drive_nlp` from two guesses: what was planned before, and the best of a few ways to
drive along the path or beside it, faster or slower. The solver finds the best plan near a guess; whether to pass before
somebody or behind, left or right, is decided by the guesses. The cheaper plan's first step is the command.
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
"""m of path, both ways, over which its corners are rounded."""
SHARES = (1.0, 0.7, 0.4, 0.15, 0.0)
"""Of the highest speed, which guesses take."""
OFFSETS = (0.0, -0.7, 0.7)
"""m beside the path, where guesses drive."""
SIDESTEP = 0.5
"""s, time constant with which guesses come to their offsets."""
SEARCH = 1.5
"""How far ahead of the last nearest point of the path the next is looked for, m."""
NOWHERE = 100.0
"""m ahead and to the left, where obstacles and people are that are not there."""
FURTHEST = 1e4
"""m, rad: beyond all sense; with much larger numbers, Fatrop does not come to an end."""


@dataclass(frozen=True, eq=False)
class DriveMpcResult:
    """What was decided; a failure is a result that brakes."""

    velocities: Array
    """Commands for each of the steps to come, linear (m/s) and angular (rad/s), (steps, 2); the first is meant now."""
    poses: Array
    """Predicted x, y (m) and yaw (rad), from the present one, (steps + 1, 3)."""
    cost: float
    """Of the plan; infinite for a failure."""
    intrusion: float
    """Largest distance by which the plan is too near to something or somebody, m."""
    solved: bool
    iterations: int
    """Of the solver, for both guesses."""
    seconds: float

    @property
    def command(self) -> tuple[float, float]:
        """Linear (m/s) and angular velocity (rad/s) for now."""
        return float(self.velocities[0, 0]), float(self.velocities[0, 1])


class DriveMpc:
    """Drives along one path (m, 2), m, past obstacles that stand.

    `nearest` gives the nearest point of each obstacle, all of them convex, to each of points (m, 2): (m, k, 2), m.
    Raises `ConfigurationError` for a path that is none.
    """

    def __init__(self, path: ArrayLike, nearest: Nearest, options: DriveMpcOptions | None = None) -> None:
        self.options = options or DriveMpcOptions()
        self.path = ArcPath(path)
        self.progress = 0.0
        """Arc length of the path's point nearest to the robot, m; it never goes back."""
        self.failures = 0
        """Decisions for which there was no solution."""
        self._nearest = nearest
        self._planned: Solution | None = None

    def decide(self, pose: ArrayLike, velocity: ArrayLike, people: ArrayLike | None = None) -> DriveMpcResult:
        """Commands for a pose x, y (m), yaw (rad) and a velocity, linear (m/s) and angular (rad/s).

        `people` (steps + 1, w, 2), m, are where w people will be, now and after each period. Raises
        `ConfigurationError` for arrays of another shape, and numbers that are not finite or beyond `FURTHEST`.
        """
        begin, options = time.perf_counter(), self.options
        x, y, yaw = _checked("a pose is x, y and yaw", pose, (3,))
        velocity = _checked("a velocity is linear and angular", velocity, (2,))
        people = np.zeros((options.steps + 1, 0, 2)) if people is None else people
        people = _checked("people are (steps + 1, w, 2)", people, (options.steps + 1, *np.shape(people)[1:2], 2))
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
        """Points (..., 2) of the path with rounded corners, and directions there."""
        spread = SMOOTHING * np.linspace(-1, 1, 5)
        way = self.path.points_at(arc + SMOOTHING) - self.path.points_at(arc - SMOOTHING)
        length = np.linalg.norm(way, axis=-1, keepdims=True)
        return self.path.points_at(arc[..., None] + spread).mean(axis=-2), way / np.maximum(length, 1e-9)

    def _planes(self, points: Array, refuge: Array) -> Array:
        """Half-planes (m, `PLANES`, 3) between points (m, 2) and obstacles; for points in one, `refuge` stands in."""
        inside = np.linalg.norm(self._nearest(points) - points[:, None], axis=-1).min(axis=1, initial=np.inf) < 1e-3
        points = np.where(inside[:, None], refuge, points)
        touch = _closest(PLANES, self._nearest(points), points)
        offset = points[:, None] - touch
        normal = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9)
        return np.concatenate((normal, (normal * touch).sum(axis=-1, keepdims=True)), axis=-1)

    def _best_drive(self, start: Array, people: Array) -> tuple[Array, Array]:
        """States and controls of the cheapest drive along the path, or beside it, with one speed."""
        options, clock = self.options, self.options.period * np.arange(self.options.steps + 1)
        wanted = np.repeat(np.array(SHARES) * options.max_speed, len(OFFSETS))[:, None]
        change = np.clip(wanted - start[3], -options.max_acceleration * clock, options.max_acceleration * clock)
        speed = start[3] + change
        arc = self.progress + np.cumsum(
            options.period * np.pad((speed[:, 1:] + speed[:, :-1]) / 2, ((0, 0), (1, 0))), 1
        )
        middle, ahead = self._along(arc)
        left = np.stack((-ahead[..., 1], ahead[..., 0]), axis=-1)
        aside = float(left[0, 0] @ (start[:2] - middle[0, 0]))
        goal = np.tile(OFFSETS, len(SHARES))[:, None]
        beside = goal + (aside - goal) * np.exp(-clock / SIDESTEP)
        places = middle + beside[..., None] * left

        room = np.linalg.norm(self._nearest(places.reshape(-1, 2)) - places.reshape(-1, 1, 2), axis=-1)
        to_things = room.min(axis=-1, initial=np.inf).reshape(arc.shape) - options.clearance
        to_people = np.linalg.norm(places[:, :, None] - people, axis=-1).min(axis=-1, initial=np.inf) - options.distance
        intrusion = np.maximum(0.0, -np.minimum(to_things, to_people))
        cost = (options.off_path * beside**2 - arc + options.intrusion * intrusion).sum(axis=1)

        best = int(cost.argmin())
        ways = np.diff(places[best], axis=0, append=places[best, -1:] + ahead[best, -1:])
        yaw = np.unwrap(np.concatenate((start[2:3], np.arctan2(ways[1:, 1], ways[1:, 0]))))
        turning = np.clip(np.gradient(yaw, options.period), -options.max_turn_rate, options.max_turn_rate)
        states = np.column_stack((places[best], yaw, speed[best], turning))
        states[0] = start
        return states, np.zeros((options.steps, CONTROLS))

    def _shifted(self, start: Array, plan: Solution) -> tuple[Array, Array]:
        """The plan of one period ago, which goes on with its last velocities."""
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
        """Where velocities (steps, 2), each reached at a period's end, lead to."""
        velocities = np.vstack((start[3:], velocities))
        way, turn = (self.options.period * (velocities[1:] + velocities[:-1]) / 2).T
        yaw = start[2] + np.concatenate(([0.0], np.cumsum(turn)))
        middle = (yaw[1:] + yaw[:-1]) / 2
        steps = np.column_stack((way * np.cos(middle), way * np.sin(middle)))
        return np.column_stack((start[:2] + np.vstack((np.zeros(2), np.cumsum(steps, axis=0))), yaw))


def _closest(count: int, others: Array, points: Array) -> Array:
    """As many of others (m, k, 2), those closest to points (m, 2), or places far away: (m, count, 2)."""
    order = np.argsort(np.linalg.norm(others - points[:, None], axis=-1), axis=1)[:, :count]
    closest = np.take_along_axis(others, order[..., None], axis=1)
    away = np.repeat(points[:, None] + NOWHERE, count - closest.shape[1], axis=1)
    return np.concatenate((closest, away), axis=1)


def _checked(wanted: str, value: Any, shape: tuple[int, ...]) -> Array:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not (np.abs(array) <= FURTHEST).all():
        raise ConfigurationError(f"{wanted}, numbers within +-{FURTHEST:g} in an array {shape}, not {value!r}")
    return array
