"""The optimal control problem of `DriveMpc`, formulated by CasADi and solved by Fatrop.

Multiple shooting of a unicycle with bounded accelerations. The objective rewards progress along the path, as in model
predictive contouring control (Lam, Manzie and Good, CDC 2010; Liniger, Domahidi and Morari, OCAM 36(5), 2015). Each
state lies in half-planes that contain no point of a convex obstacle, and outside discs around pedestrians. Both
constraints are soft, at a high price, so that a solution always exists. Fatrop (Vanroye, Sathya, De Schutter and Decré,
IROS 2023) is an interior-point method that exploits the stage structure: it takes a third of IPOPT's time here.

Fatrop always begins with multipliers of 1. If it gets the cost times `SCALE`, they are nearer to the solution's, and
from a guess as near as the last plan, with a low barrier parameter from the beginning, it takes 5 iterations, not 11.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any

import casadi
import numpy as np
from pydantic import Field

from armctl.control.drive_limits import DriveLimits
from armctl.core.arrays import Array
from armctl.core.interrupts import interrupts_raised
from armctl.core.options import NonNegative, Positive, options

Constraint = tuple[Any, float, float]
"""Expression and its lower and upper bound."""

STATES, CONTROLS = 5, 3
"""x, y (m), yaw (rad), linear (m/s) and angular velocity (rad/s); their accelerations, and the slack (m)."""
PLANES, PEOPLE = 4, 3
"""Numbers of static obstacles and of pedestrians that constrain each step: the nearest ones."""
SCALE = 10.0
"""Scale of the cost, for the solver."""
BRAKING_SHARE = 0.8
"""Share of the acceleration with which at least a robot brakes that is faster than it may be."""


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
    """Predicted periods: enough to stop, or to pass a pedestrian who walks across the path."""
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
    """Solver iterations for a plan, which bounds its time."""
    max_search_iterations: Annotated[int, Field(ge=0)] = 16
    """Solver iterations for a second plan; the search goes on in the next control step."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution of the nonlinear program."""

    knots: Array
    """States and, until the next knot, controls, (steps + 1, `STATES` + `CONTROLS`); the last controls are 0."""
    cost: float
    solved: bool
    iterations: int


class DriveNlp:
    """The problem for one set of options. Building it takes 0.2 s: `drive_nlp` caches it."""

    def __init__(self, options: DriveMpcOptions) -> None:
        self.options = options
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
        constraints: list[Constraint] = []
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
            constraints.append((states[k + 1] - _next_state(state, control, options.period), 0.0, 0.0))
            if k == 0:
                constraints.append((state - start, 0.0, 0.0))
            else:
                constraints += _state_constraints(options, state, control[2], planes[:, k], people[:, k])

        expressions, *constraint_bounds = zip(*constraints, strict=True)
        sizes = [expression.numel() for expression in expressions]
        lower, upper = (np.repeat(bound, sizes) for bound in constraint_bounds)
        self.problem = {
            "x": casadi.vertcat(*variables),
            "p": casadi.vertcat(start, *(casadi.vec(values) for values in (reference, planes, people))),
            "f": cost,
            "g": casadi.vertcat(*expressions),
        }
        """For `casadi.nlpsol`."""
        self.bounds = {"lbx": np.array(low), "ubx": np.array(high), "lbg": lower, "ubg": upper}
        structure = (lower == upper).tolist()
        self.functions: dict[tuple[bool, bool], Any] = {
            (near, brief): self._function(near, brief, structure)
            for near, brief in itertools.product((True, False), repeat=2)
        }
        """The solver for guesses near a solution or not, of few iterations (`max_search_iterations`) or not."""

    def _function(self, near: bool, brief: bool, equality: list[bool]) -> Any:
        barrier, options = 3e-4 if near else 0.1, self.options
        fatrop = {
            "print_level": 0,
            "tol": 5e-5 * SCALE,
            "mu_init": barrier * SCALE,
            "max_iter": min(options.max_iterations, options.max_search_iterations) if brief else options.max_iterations,
        }
        if near:
            fatrop |= {"bound_push": 1e-3, "bound_frac": 1e-3}
        return casadi.nlpsol(
            "drive", "fatrop", {**self.problem, "f": SCALE * self.problem["f"]},
            {
                "structure_detection": "auto", "equality": equality, "print_time": False, "error_on_fail": False,
                "calc_lam_p": False, "calc_lam_x": False, "fatrop": fatrop,
            },
        )  # fmt: skip


class DriveSolver:
    """Solver of a problem, with memory of its own: other solvers have no influence.

    Write the problem and the guess into its arrays before `solve`.
    """

    def __init__(self, options: DriveMpcOptions, near: bool, brief: bool) -> None:
        self._made_of = options, near, brief
        nlp = drive_nlp(options)
        steps, function = options.steps, nlp.functions[near, brief]
        self.knots = np.zeros((steps + 1, STATES + CONTROLS))
        """The guess, as in `Solution`."""
        sizes = (STATES, 4 * (steps + 1), 3 * PLANES * (steps + 1), 2 * PEOPLE * (steps + 1))
        self.parameters = np.zeros(sum(sizes))
        start, reference, planes, people = np.split(self.parameters, np.cumsum(sizes[:-1]))
        self.start = start
        """The state now (`STATES`,)."""
        self.reference = reference.reshape(-1, 4)
        """Points of the path and its directions there, (steps + 1, 4)."""
        self.planes = planes.reshape(-1, PLANES, 3)
        """Normals n and offsets o of constraints n p - o >= clearance, (steps + 1, `PLANES`, 3)."""
        self.people = people.reshape(-1, PEOPLE, 2)
        """Where people are, (steps + 1, `PEOPLE`, 2) m."""
        self._solution, self._cost = np.zeros_like(self.knots), np.zeros(1)
        # CasADi reads and writes these arrays where they are, so they have to live as long as its buffer.
        bounds = {name: bound.copy() for name, bound in nlp.bounds.items()}
        self._arguments: dict[str, Any] = {"x0": _variables(self.knots), "p": self.parameters, **bounds}
        results: dict[str, Any] = {"x": _variables(self._solution), "f": self._cost}
        self._buffer, self._solve = function.buffer()
        for name, array in self._arguments.items():
            self._buffer.set_arg(function.index_in(name), memoryview(array))
        for name, array in results.items():
            self._buffer.set_res(function.index_out(name), memoryview(array))

    def __reduce__(self) -> Any:
        return DriveSolver, self._made_of

    def limit(self, limits: DriveLimits) -> None:
        """Change the bounds on velocities and accelerations, and move the planes of `planes` by the margin.

        Velocities above the limit brake first.
        """
        self.planes[..., 2] += limits.margin
        options, start = self._made_of[0], np.abs(self.start[3:])
        accelerations = np.array((limits.max_acceleration, limits.max_turn_acceleration))
        clock = options.period * np.arange(1, options.steps + 1)[:, None]
        braking = start - BRAKING_SHARE * accelerations * clock
        highest = np.maximum((limits.max_speed, limits.max_turn_rate), braking)
        lowest = np.maximum((min(options.max_reverse, limits.max_speed), limits.max_turn_rate), braking)
        for name, velocities, controls in (("lbx", -lowest, -accelerations), ("ubx", highest, accelerations)):
            bound = np.append(self._arguments[name], np.zeros(CONTROLS)).reshape(-1, STATES + CONTROLS)
            bound[1:, 3:STATES], bound[:-1, STATES : STATES + 2] = velocities, controls
            self._arguments[name][:] = _variables(bound)

    def solve(self) -> Solution:
        """Return the local optimum near the guess. A failure is a result that is not `solved`."""
        try:
            with interrupts_raised():
                self._solve()
            stats = self._buffer.stats()
        except RuntimeError:  # Fatrop's exceptions, such as overflow
            return Solution(self.knots.copy(), math.inf, False, 0)
        solved = bool(stats["success"]) and bool(np.isfinite(self._solution).all())
        return Solution(self._solution.copy(), float(self._cost[0]) / SCALE, solved, int(stats["iter_count"]))


@lru_cache(maxsize=8)
def drive_nlp(options: DriveMpcOptions) -> DriveNlp:
    """Return the problem that all robots with these options share."""
    return DriveNlp(options)


def _variables(knots: Array) -> Array:
    """Return the variables of the problem: all but the last controls."""
    return knots.reshape(-1)[:-CONTROLS]


def _next_state(state: Any, control: Any, period: float) -> Any:
    """Return the state after a period of constant accelerations, by the midpoint rule."""
    yaw = state[2] + period / 2 * (state[4] + period / 4 * control[1])
    distance = period * (state[3] + period / 2 * control[0])
    turn = period * (state[4] + period / 2 * control[1])
    return state + casadi.vertcat(distance * casadi.cos(yaw), distance * casadi.sin(yaw), turn, period * control[:2])


def _state_constraints(
    options: DriveMpcOptions, state: Any, slack: Any, planes: Any, people: Any
) -> Iterator[Constraint]:
    """Yield what keeps a state clear of obstacles and people, up to the slack, and its wheels within their speed."""
    for i in range(PLANES):
        normal, level = planes[3 * i : 3 * i + 2], planes[3 * i + 2]
        yield casadi.dot(normal, state[:2]) - level - options.clearance + slack, 0.0, math.inf
    for i in range(PEOPLE if options.distance else 0):
        offset = state[:2] - people[2 * i : 2 * i + 2]
        excess = (casadi.dot(offset, offset) / options.distance - options.distance) / 2  # m, to first order
        yield excess + slack, 0.0, math.inf
    if options.max_rim_speed < math.inf:
        for side in (-options.half_track, options.half_track):
            yield state[3] + side * state[4], -options.max_rim_speed, options.max_rim_speed


def _stage_cost(options: DriveMpcOptions, state: Any, reference: Any) -> Any:
    offset, direction = state[:2] - reference[:2], reference[2:]
    lateral = direction[0] * offset[1] - direction[1] * offset[0]
    aligned = direction[0] * casadi.cos(state[2]) + direction[1] * casadi.sin(state[2])
    cost = options.off_path * lateral**2 - casadi.dot(direction, offset)
    return cost + options.misaligned * (1 - aligned) + options.turn_rate * state[4] ** 2
