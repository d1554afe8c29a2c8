"""The optimal control problem of `DriveMpc`, formulated by CasADi and solved by Fatrop.

Multiple shooting of a unicycle whose velocities change at bounded rates. The reward is progress along the path, as in
model predictive contouring control (Lam, Manzie and Good, CDC 2010; Liniger, Domahidi and Morari, OCAM 36(5), 2015).
The robot keeps to half-planes that hold no point of a convex obstacle, and out of discs that move with whoever walks.
Both give way at a high price, so that there is always a solution. Fatrop (Vanroye, Sathya, De Schutter and Decré,
IROS 2023) is an interior-point method that makes use of the stages: here it takes a third of IPOPT's time.
"""

import math
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from armctl.errors import ConfigurationError

Array = NDArray[np.float64]

STATES, CONTROLS = 5, 3
"""x, y (m), yaw (rad), linear (m/s) and angular velocity (rad/s); their accelerations, and the slack (m)."""
PLANES, PEOPLE = 4, 3
"""How many obstacles that stand, and how many people, are looked at in each step: the nearest ones."""


@dataclass(frozen=True)
class DriveMpcOptions:
    """Options of `DriveMpc`."""

    max_speed: float = 2.0
    """m/s."""
    max_reverse: float = 0.5
    """m/s."""
    max_turn_rate: float = 2.5
    """rad/s."""
    max_acceleration: float = 4.0
    """m/s^2."""
    max_turn_acceleration: float = 10.0
    """rad/s^2."""
    max_rim_speed: float = math.inf
    """Of the wheels of either side, m/s."""
    half_track: float = 0.3
    """m from the middle where the wheels would be, were there no skidding: rim speed = linear -+ this x angular."""
    clearance: float = 0.35
    """m from the robot's centre to whatever stands."""
    distance: float = 0.75
    """m from the robot's centre to the centre of whoever walks."""
    period: float = 0.1
    """s between two decisions, and between two predicted poses."""
    steps: int = 25
    """Predicted periods: enough to stop, or to pass whoever walks across the path."""
    off_path: float = 1.0
    """Price of a distance from the path, 1/m^2; a metre of progress earns 1 in each step."""
    misaligned: float = 0.5
    """Price of the robot's yaw off the path's direction, for 1 - cos."""
    acceleration: tuple[float, float] = (0.02, 0.005)
    """Price of squared accelerations, linear, s^4/m^2, and angular, s^4."""
    turn_rate: float = 0.02
    """Price of a squared turn rate, s^2."""
    intrusion: float = 300.0
    """Price of a metre too near to somebody or something, 1/m: higher than what such a short cut could earn."""
    max_iterations: int = 100
    """Of the solver, and with it a bound on its time."""

    def __post_init__(self) -> None:
        for option in fields(self):
            value = getattr(self, option.name)
            least = 1e-9 if option.name in ("period", "max_speed", "max_acceleration", "max_turn_acceleration") else 0.0
            numbers = value if isinstance(value, tuple) else (value,)
            if not all(isinstance(number, (int, float)) and number >= least for number in numbers):
                raise ConfigurationError(f"{option.name} is not below {least:g}, which {value!r} is")
        if not (isinstance(self.steps, int) and 2 <= self.steps <= 200):
            raise ConfigurationError(f"steps is a whole number from 2 to 200, not {self.steps!r}")


@dataclass(frozen=True, eq=False)
class Solution:
    """What the solver has to say."""

    states: Array
    """(steps + 1, `STATES`)."""
    controls: Array
    """(steps, `CONTROLS`)."""
    cost: float
    solved: bool
    iterations: int


class DriveNlp:
    """The problem for one set of options; get it by `drive_nlp`, for making it takes 0.1 s."""

    def __init__(self, options: DriveMpcOptions) -> None:
        steps = options.steps
        start = casadi.SX.sym("start", STATES)
        reference = casadi.SX.sym("reference", 4, steps + 1)
        planes = casadi.SX.sym("planes", 3 * PLANES, steps + 1)
        people = casadi.SX.sym("people", 2 * PEOPLE, steps + 1)
        states = [casadi.SX.sym(f"state_{k}", STATES) for k in range(steps + 1)]
        controls = [casadi.SX.sym(f"control_{k}", CONTROLS) for k in range(steps)]
        most = (options.max_acceleration, options.max_turn_acceleration)
        state_bounds = np.array((math.inf, math.inf, math.inf, options.max_speed, options.max_turn_rate))
        slowest = np.where(np.arange(STATES) == 3, -options.max_reverse, -state_bounds)

        cost: Any = 0
        variables: list[Any] = []
        low: list[float] = []
        high: list[float] = []
        constraints, least, greatest, structure = [], [], [], []

        def constrain(expression: Any, lower: float, upper: float) -> None:
            constraints.append(expression)
            count = expression.numel()
            least.extend([lower] * count)
            greatest.extend([upper] * count)
            structure.extend([lower == upper] * count)

        for k, state in enumerate(states):
            cost += _stage_cost(options, state, reference[:, k])
            variables.append(state)
            low.extend(slowest if k else [-math.inf] * STATES)  # it starts with the velocity that it has
            high.extend(state_bounds if k else [math.inf] * STATES)
            if k == steps:
                break
            control = controls[k]
            cost += casadi.dot(casadi.SX(list(options.acceleration)), control[:2] ** 2)
            cost += options.intrusion * (control[2] + control[2] ** 2)
            variables.append(control)
            low.extend((-most[0], -most[1], 0.0))
            high.extend((*most, math.inf))
            constrain(states[k + 1] - _next_state(state, control, options.period), 0.0, 0.0)
            if k == 0:
                constrain(state - start, 0.0, 0.0)
                continue
            for i in range(PLANES):
                normal, offset = planes[3 * i : 3 * i + 2, k], planes[3 * i + 2, k]
                constrain(casadi.dot(normal, state[:2]) - offset - options.clearance + control[2], 0.0, math.inf)
            for i in range(PEOPLE if options.distance else 0):
                apart = state[:2] - people[2 * i : 2 * i + 2, k]
                excess = (casadi.dot(apart, apart) / options.distance - options.distance) / 2  # m, to first order
                constrain(excess + control[2], 0.0, math.inf)
            if options.max_rim_speed < math.inf:
                for side in (-options.half_track, options.half_track):
                    constrain(state[3] + side * state[4], -options.max_rim_speed, options.max_rim_speed)

        self.problem = {
            "x": casadi.vertcat(*variables),
            "p": casadi.vertcat(start, *(casadi.vec(one) for one in (reference, planes, people))),
            "f": cost,
            "g": casadi.vertcat(*constraints),
        }
        """For `casadi.nlpsol`."""
        self.bounds = {"lbx": low, "ubx": high, "lbg": least, "ubg": greatest}
        self._steps = steps
        self._solver = casadi.nlpsol(
            "drive", "fatrop", self.problem,
            {
                "structure_detection": "auto", "equality": structure, "print_time": False, "error_on_fail": False,
                "fatrop": {"print_level": 0, "tol": 1e-4, "max_iter": options.max_iterations},
            },
        )  # fmt: skip

    def solve(
        self, start: Array, reference: Array, planes: Array, people: Array, states: Array, controls: Array
    ) -> Solution:
        """The solution nearest to a guess.

        `start` (`STATES`,); `reference` (steps + 1, 4): points of the path and its directions there; `planes`
        (steps + 1, `PLANES`, 3): normals n and offsets o, to keep n p - o >= clearance; `people` (steps + 1, `PEOPLE`,
        2), m; the guess as in `Solution`. A failure is a result that is not `solved`.
        """
        parameters = np.concatenate([one.ravel() for one in (start, reference, planes, people)])
        try:
            with _interrupts_kept():
                found = self._solver(x0=_joined(states, controls), p=parameters, **self.bounds)
            stats = self._solver.stats()
        except RuntimeError:  # Fatrop's exceptions, as for numbers that overflow
            return Solution(states, controls, math.inf, False, 0)
        states, controls = self._split(np.asarray(found["x"]).ravel())
        solved = bool(stats["success"]) and bool(np.isfinite(states).all() and np.isfinite(controls).all())
        return Solution(states, controls, float(found["f"]), solved, int(stats["iter_count"]))

    def _split(self, variables: Array) -> tuple[Array, Array]:
        stages = variables[:-STATES].reshape(self._steps, STATES + CONTROLS)
        return np.vstack((stages[:, :STATES], variables[-STATES:])), stages[:, STATES:]


@lru_cache(maxsize=8)
def drive_nlp(options: DriveMpcOptions) -> DriveNlp:
    """The one problem that all robots with these options share."""
    return DriveNlp(options)


@contextmanager
def _interrupts_kept() -> Iterator[None]:
    """Raise an interrupt (Ctrl-C) afterwards: CasADi takes it for an end of the search, and nobody else hears of it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    kept: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: kept.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if kept:
            signal.raise_signal(signal.SIGINT)


def _joined(states: Array, controls: Array) -> Array:
    return np.concatenate((np.hstack((states[:-1], controls)).ravel(), states[-1]))


def _next_state(state: Any, control: Any, period: float) -> Any:
    """After a period of constant accelerations, by the midpoint rule."""
    yaw = state[2] + period / 2 * (state[4] + period / 4 * control[1])
    way = period * (state[3] + period / 2 * control[0])
    turn = period * (state[4] + period / 2 * control[1])
    return state + casadi.vertcat(way * casadi.cos(yaw), way * casadi.sin(yaw), turn, period * control[:2])


def _stage_cost(options: DriveMpcOptions, state: Any, reference: Any) -> Any:
    offset, way = state[:2] - reference[:2], reference[2:]
    aside = way[0] * offset[1] - way[1] * offset[0]
    aligned = way[0] * casadi.cos(state[2]) + way[1] * casadi.sin(state[2])
    cost = options.off_path * aside**2 - casadi.dot(way, offset)
    return cost + options.misaligned * (1 - aligned) + options.turn_rate * state[4] ** 2
