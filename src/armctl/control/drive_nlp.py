"""The optimal control problem of `DriveMpc`, formulated by CasADi and solved by Fatrop.

Multiple shooting of a unicycle with bounded accelerations. The objective rewards progress along the path, as in model
predictive contouring control (Lam, Manzie and Good, CDC 2010; Liniger, Domahidi and Morari, OCAM 36(5), 2015). Each
state lies in half-planes that contain no point of a convex obstacle, and outside discs around pedestrians. Both
constraints are soft, at a high price, so that a solution always exists. Fatrop (Vanroye, Sathya, De Schutter and Decré,
IROS 2023) is an interior-point method that exploits the stage structure: it takes a third of IPOPT's time here.
"""

import math
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import casadi
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.options import options

Array = NDArray[np.float64]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]

STATES, CONTROLS = 5, 3
"""x, y (m), yaw (rad), linear (m/s) and angular velocity (rad/s); their accelerations, and the slack (m)."""
PLANES, PEOPLE = 4, 3
"""Numbers of static obstacles and of pedestrians that constrain each step: the nearest ones."""


@options
class DriveMpcOptions:
    """Options of `DriveMpc`."""

    max_speed: Positive = 2.0
    """m/s."""
    max_reverse: NonNegative = 0.5
    """m/s."""
    max_turn_rate: NonNegative = 2.5
    """rad/s."""
    max_acceleration: Positive = 4.0
    """m/s^2."""
    max_turn_acceleration: Positive = 10.0
    """rad/s^2."""
    max_rim_speed: Annotated[float, Field(ge=0, allow_inf_nan=True)] = math.inf
    """m/s: rim speed of the wheels."""
    half_track: NonNegative = 0.3
    """m: effective half track, with skidding: rim speed = linear -+ this x angular velocity."""
    clearance: NonNegative = 0.35
    """m: distance of the robot's centre from static obstacles."""
    distance: NonNegative = 0.75
    """m: distance of the robot's centre from the centres of pedestrians; 0 ignores them."""
    period: Positive = 0.1
    """s: control period, and time between two predicted poses."""
    steps: Annotated[int, Field(ge=2, le=200)] = 25
    """Predicted periods: enough to stop, or to pass somebody who walks across the path."""
    off_path: NonNegative = 1.0
    """Weight of the squared distance from the path, 1/m^2; a metre of progress earns 1 in each step."""
    misaligned: NonNegative = 0.5
    """Weight of 1 - cos(angle between the robot and the path)."""
    acceleration: tuple[NonNegative, NonNegative] = (0.02, 0.005)
    """Weights of squared linear (s^4/m^2) and angular acceleration (s^4)."""
    turn_rate: NonNegative = 0.02
    """Weight of the squared turn rate, s^2."""
    intrusion: NonNegative = 300.0
    """Penalty per metre of clearance violation, 1/m: higher than the gain of any such shortcut."""
    max_iterations: Annotated[int, Field(ge=0)] = 100
    """Solver iterations, which bounds its time."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution of the nonlinear program."""

    states: Array
    """(steps + 1, `STATES`)."""
    controls: Array
    """(steps, `CONTROLS`)."""
    cost: float
    solved: bool
    iterations: int


class DriveNlp:
    """The problem for one set of options. Building it takes 0.1 s: `drive_nlp` caches it."""

    def __init__(self, options: DriveMpcOptions) -> None:
        steps = options.steps
        start = casadi.SX.sym("start", STATES)
        reference = casadi.SX.sym("reference", 4, steps + 1)
        planes = casadi.SX.sym("planes", 3 * PLANES, steps + 1)
        people = casadi.SX.sym("people", 2 * PEOPLE, steps + 1)
        states = [casadi.SX.sym(f"state_{k}", STATES) for k in range(steps + 1)]
        controls = [casadi.SX.sym(f"control_{k}", CONTROLS) for k in range(steps)]
        max_accelerations = (options.max_acceleration, options.max_turn_acceleration)
        state_bounds = np.array((math.inf, math.inf, math.inf, options.max_speed, options.max_turn_rate))
        state_lower = np.where(np.arange(STATES) == 3, -options.max_reverse, -state_bounds)

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
            low.extend(state_lower if k else [-math.inf] * STATES)  # the first state is given
            high.extend(state_bounds if k else [math.inf] * STATES)
            if k == steps:
                break
            control = controls[k]
            cost += casadi.dot(casadi.SX(list(options.acceleration)), control[:2] ** 2)
            cost += options.intrusion * (control[2] + control[2] ** 2)
            variables.append(control)
            low.extend((-max_accelerations[0], -max_accelerations[1], 0.0))
            high.extend((*max_accelerations, math.inf))
            constrain(states[k + 1] - _next_state(state, control, options.period), 0.0, 0.0)
            if k == 0:
                constrain(state - start, 0.0, 0.0)
                continue
            for i in range(PLANES):
                normal, level = planes[3 * i : 3 * i + 2, k], planes[3 * i + 2, k]
                constrain(casadi.dot(normal, state[:2]) - level - options.clearance + control[2], 0.0, math.inf)
            for i in range(PEOPLE if options.distance else 0):
                offset = state[:2] - people[2 * i : 2 * i + 2, k]
                excess = (casadi.dot(offset, offset) / options.distance - options.distance) / 2  # m, to first order
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
        """The local optimum near a guess.

        `start` (`STATES`,); `reference` (steps + 1, 4): points of the path and its directions there; `planes`
        (steps + 1, `PLANES`, 3): normals n and offsets o of constraints n p - o >= clearance; `people` (steps + 1,
        `PEOPLE`, 2), m; `states` and `controls` of the guess as in `Solution`. A failure is a result not `solved`.
        """
        parameters = np.concatenate([one.ravel() for one in (start, reference, planes, people)])
        try:
            with _deferred_interrupts():
                found = self._solver(x0=_joined(states, controls), p=parameters, **self.bounds)
            stats = self._solver.stats()
        except RuntimeError:  # Fatrop's exceptions, such as overflow
            return Solution(states, controls, math.inf, False, 0)
        states, controls = self._split(np.asarray(found["x"]).ravel())
        solved = bool(stats["success"]) and bool(np.isfinite(states).all() and np.isfinite(controls).all())
        return Solution(states, controls, float(found["f"]), solved, int(stats["iter_count"]))

    def _split(self, variables: Array) -> tuple[Array, Array]:
        stages = variables[:-STATES].reshape(self._steps, STATES + CONTROLS)
        return np.vstack((stages[:, :STATES], variables[-STATES:])), stages[:, STATES:]


@lru_cache(maxsize=8)
def drive_nlp(options: DriveMpcOptions) -> DriveNlp:
    """The problem that all robots with these options share."""
    return DriveNlp(options)


@contextmanager
def _deferred_interrupts() -> Iterator[None]:
    """Raise an interrupt (Ctrl-C) after the block: CasADi would swallow it and end the search."""
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
    """The state after a period of constant accelerations, by the midpoint rule."""
    yaw = state[2] + period / 2 * (state[4] + period / 4 * control[1])
    distance = period * (state[3] + period / 2 * control[0])
    turn = period * (state[4] + period / 2 * control[1])
    return state + casadi.vertcat(distance * casadi.cos(yaw), distance * casadi.sin(yaw), turn, period * control[:2])


def _stage_cost(options: DriveMpcOptions, state: Any, reference: Any) -> Any:
    offset, direction = state[:2] - reference[:2], reference[2:]
    lateral = direction[0] * offset[1] - direction[1] * offset[0]
    aligned = direction[0] * casadi.cos(state[2]) + direction[1] * casadi.sin(state[2])
    cost = options.off_path * lateral**2 - casadi.dot(direction, offset)
    return cost + options.misaligned * (1 - aligned) + options.turn_rate * state[4] ** 2
