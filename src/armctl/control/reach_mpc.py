"""Model-predictive control of an arm by the real-time iteration of sequential quadratic programming (RTI-SQP).

Each control step linearises the problem at the last plan, shifted by a period, and solves one quadratic program (Diehl,
Bock, Schloeder: "A real-time iteration scheme for nonlinear optimization in optimal feedback control", SIAM J. Control
and Optimization 43, 2005), followed by a line search. OSQP solves it, warm-started (Stellato et al., "OSQP: an operator
splitting solver for quadratic programs", Mathematical Programming Computation 12, 2020).

Two things make one iteration enough. The Hessian is the exact one of each knot, convexified (Verschueren et al., "A
sparsity preserving convexification procedure for indefinite quadratic programs arising in direct optimal control", SIAM
J. Optimization 27, 2017), since the Gauss-Newton Hessian misleads far from the target. The first guess leads straight
to the posture.
"""

import math
import time
from dataclasses import field, replace
from typing import Annotated

import numpy as np
import osqp
from numpy.typing import ArrayLike
from pydantic import Field

from armctl.control.reach_problem import (
    JointTrajectory,
    MpcResult,
    OcpParameters,
    ReachProblem,
    braking,
    cost,
    project_onto_limits,
    straight_to,
)
from armctl.control.reach_qp import ReachQp
from armctl.core.arrays import Array
from armctl.core.options import Count, Positive, options
from armctl.kernels import reach_mpc as kernel
from armctl.kernels.clearance import ScaledScene
from armctl.kinematics import ArmModel
from armctl.kinematics.clearance import Clearance
from armctl.scene import Boxes

RELAXATION = 1.8
"""OSQP's alpha: near 2, as Stellato et al. advise"""
NEARBY = 0.15
"""m: distance from the targets within which the Gauss-Newton Hessian is good enough"""
STEPS = (1.0, 0.3)
"""Step lengths of the line search, the longest first"""
PERIODS_BETWEEN, SHARES_BETWEEN, MIN_BETWEEN = 10, np.array((0.25, 0.5, 0.75)).reshape(3, 1, 1), 0.005
"""First periods of a plan in which distances are measured between knots, shares of a period, and least distance, m."""
USABLE = (
    osqp.SolverStatus.OSQP_SOLVED,
    osqp.SolverStatus.OSQP_SOLVED_INACCURATE,
    osqp.SolverStatus.OSQP_MAX_ITER_REACHED,
)
"""Accepted solver states. An unfinished solution is a direction too, and the next control step resumes from it."""


@options
class ReachMpcOptions:
    """Options of `ReachMpc`."""

    problem: ReachProblem = field(default_factory=ReachProblem)
    max_iterations: Count = 15
    """Solver iterations of a plan."""
    tolerance: Positive = 1e-4
    """Absolute and relative tolerance of the solver."""
    step_size: Positive = 0.1
    """The solver's rho."""
    pairs: Annotated[int, Field(ge=0)] = 4
    """Number of collision pairs (links, floor and boxes), the nearest ones, that constrain each knot."""
    margin: Positive = 0.03
    """m: distance that pairs keep at the knots, with a reserve for the motion in between. Pairs that cannot
    keep it, keep less: see `Clearance`."""
    influence_distance: Positive = 0.15
    """m: distance below which pairs become constraints."""
    slack_penalty: Positive = 50.0
    """m^2 per m of violation: more than any shorter path could save."""


class ReachMpc:
    """Plans the motion of one arm's end-effector to targets, once per control step."""

    def __init__(self, model: ArmModel, options: ReachMpcOptions | None = None) -> None:
        self.model = model
        self.options = options or ReachMpcOptions()
        self.problem = self.options.problem
        self.failures = 0
        """Number of quadratic programs that the solver failed to solve."""
        self._unconstrained = _Solver(self.options, model, rows=0)
        self._constrained = (
            _Solver(self.options, model, self.options.pairs) if self.options.pairs else self._unconstrained
        )
        self.clearance = Clearance(model, self.options.margin)
        self.surround(model.boxes)

    def surround(self, boxes: Boxes) -> None:
        """Keep clear of these boxes from now on, and forget the last plan."""
        self.model, self.problem = self.model.among(boxes), self.options.problem
        self._keep_clear_of(self.clearance.among(boxes))
        self.reset()

    def follow(self, way: Array, posture_weight: float) -> None:
        """Keep no farther away from anything than a way (n, dof) does, until it is surrounded by other boxes.

        `posture_weight` (m^2/rad^2) is that of the postures on it.
        """
        self.problem = replace(self.options.problem, posture=posture_weight)
        self._keep_clear_of(self.clearance.along(way))

    def _keep_clear_of(self, scene: ScaledScene) -> None:
        self.clearance.scene = scene
        self.scene = scene if self.options.pairs else scene._replace(pairs=scene.pairs[:0])
        """What to keep clear of, for `armctl.kernels.reach_mpc`."""

    def reset(self) -> None:
        """Forget the last plan, for a new episode."""
        self._last: JointTrajectory | None = None
        self._posture: Array | None = None
        self._duals = self._constrained.qp.first_duals()

    def begin(self, position: ArrayLike, velocity: ArrayLike, posture: ArrayLike) -> JointTrajectory:
        """Take a straight motion to a posture (dof,) rad as the next plan's first guess. It takes a tenth of the time.

        Raises `ConfigurationError` as `plan` does.
        """
        no_target = np.zeros(3)
        parameters = OcpParameters.checked(self.problem, self.model.dof, position, velocity, no_target, posture)
        assert parameters.posture is not None
        self.reset()
        self._last = straight_to(self.problem, self.model.limits, parameters, parameters.posture)
        self._posture = parameters.posture
        return self._last

    def plan(
        self, position: ArrayLike, velocity: ArrayLike, targets: ArrayLike, posture: ArrayLike | None = None
    ) -> MpcResult:
        """Plan a motion from joint `position` (dof,) rad and `velocity` (dof,) rad/s.

        `targets` (N, 3) m are the end-effector positions wanted at the end of each period; (3,) is a target at rest.
        With 12 numbers they are places, of a pose: see `armctl.kinematics.MinimumTimePose`.
        `posture` (dof,) rad is the joint positions preferred, from a global search, since this one is local.
        Raises `ConfigurationError` for arguments of other shapes, or not finite.
        """
        began = time.perf_counter()
        parameters = OcpParameters.checked(self.problem, self.model.dof, position, velocity, targets, posture)
        worst = braking(self.problem, self.model.limits, parameters)
        guess = self._first_guess(parameters, worst)
        velocities, iterations = self._solve(parameters, worst, guess)
        if velocities is None:
            self.failures += 1
            self.reset()
            best = _Linearisation(self, parameters, worst)
        else:
            best = self._safe(parameters, worst, self._line_search(parameters, guess, velocities))
            self._last, self._posture = best.motion, parameters.posture
        motion = best.motion
        return MpcResult(
            motion.positions, motion.velocities, motion.accelerations,
            best.cost, best.min_distance, velocities is not None, iterations, time.perf_counter() - began,
        )  # fmt: skip

    def _first_guess(self, parameters: OcpParameters, worst: JointTrajectory) -> "_Linearisation":
        """Return the last plan, shifted by a period; for a new posture, also the straight motion to it; or braking."""
        limits, guesses = self.model.limits, []
        if self._last is not None:
            shifted = np.concatenate((self._last.velocities[1:], self._last.velocities[-1:]))
            guesses.append(project_onto_limits(self.problem, limits, parameters, shifted))
            self._constrained.qp.shift(self._duals)
        goal, last_goal = parameters.posture, self._posture
        if goal is not None and (last_goal is None or not np.array_equal(last_goal, goal)):
            guesses.append(straight_to(self.problem, limits, parameters, goal))
        linearised = [_Linearisation(self, parameters, guess) for guess in guesses or [worst]]
        return min(linearised, key=lambda guess: guess.merit)

    def _safe(self, parameters: OcpParameters, worst: JointTrajectory, best: "_Linearisation") -> "_Linearisation":
        """Return the plan, unless braking after its first period would come too late for an obstacle: then braking now.

        A few iterations may not suffice to plan around an obstacle.
        """
        min_distance = self.options.margin / 2
        if best.min_distance >= min_distance and self._between(best.motion, best.min_distance) >= MIN_BETWEEN:
            return best
        first, falls = best.motion.velocities[1], self.model.limits.acceleration * self.problem.period
        speeds = np.maximum(np.abs(first) - np.arange(self.problem.horizon)[:, None] * falls, 0.0)
        velocities = np.concatenate((parameters.velocity[None], np.copysign(speeds, first)))
        later = _Linearisation(
            self, parameters, project_onto_limits(self.problem, self.model.limits, parameters, velocities)
        )
        nearest = min(later.min_distance, self._between(later.motion, later.min_distance))
        if later.min_distance >= min_distance and nearest >= MIN_BETWEEN:
            return best
        braking = _Linearisation(self, parameters, worst)
        between = self._between(braking.motion, braking.min_distance)
        return braking if min(braking.min_distance, between) > nearest else best

    def _between(self, motion: JointTrajectory, distance: float) -> float:
        """Return the least distance between the first knots, m: fast arms move by 0.1 m from one to the next.

        It is infinite if the knots are far from everything.
        """
        if distance >= self.options.influence_distance:
            return math.inf
        q = motion.positions[: PERIODS_BETWEEN + 1]
        between = q[:-1] + SHARES_BETWEEN * np.diff(q, axis=0)
        return float(self.clearance.min_distances(between.reshape(-1, q.shape[1]), self.scene).min())

    def _solve(
        self, parameters: OcpParameters, worst: JointTrajectory, at: "_Linearisation"
    ) -> tuple[Array | None, int]:
        """Return velocities (N + 1, dof) from the problem linearised `at` a motion (None: unsolved); and iterations."""
        solver = self._constrained if at.min_distance < self.options.influence_distance else self._unconstrained
        qp = solver.qp
        qp.write(parameters, worst, *at.quadratic_model())
        if qp.rows:
            q = at.motion.positions[1:]
            qp.write_obstacles(q, *self.clearance.nearest(q, qp.rows), self.options.margin)
        motion = at.motion
        displacements = motion.velocities[1:] * self.problem.period
        solution = solver.solve(np.concatenate((motion.positions[1:].ravel(), displacements.ravel())), self._duals)
        if solution is None:
            return None, solver.iterations
        displacements = solution[qp.states : 2 * qp.states].reshape(-1, self.model.dof)
        return np.concatenate((parameters.velocity[None], displacements / self.problem.period)), solver.iterations

    def _line_search(self, parameters: OcpParameters, guess: "_Linearisation", velocities: Array) -> "_Linearisation":
        """Return the motion after the longest step from a guess towards `velocities` that makes it cheaper."""
        for step in STEPS:
            targets = guess.motion.velocities + step * (velocities - guess.motion.velocities)
            motion = project_onto_limits(self.problem, self.model.limits, parameters, targets)
            candidate = _Linearisation(self, parameters, motion)
            if candidate.merit < guess.merit:
                return candidate
        return guess


class _Solver:
    """OSQP for quadratic programs of one sparsity pattern."""

    def __init__(self, options: ReachMpcOptions, model: ArmModel, rows: int) -> None:
        self.qp = ReachQp(options.problem, model.limits, rows, options.slack_penalty)
        self.iterations = 0
        self._osqp = osqp.OSQP()
        self._osqp.setup(
            self.qp.hessian, self.qp.gradient, self.qp.matrix, self.qp.lower, self.qp.upper,
            verbose=False, polishing=False, scaling=0, adaptive_rho=False, rho=options.step_size, alpha=RELAXATION,
            eps_abs=options.tolerance, eps_rel=options.tolerance, max_iter=options.max_iterations, check_termination=5,
        )  # fmt: skip

    def solve(self, start: Array, duals: Array) -> Array | None:
        """Return the solution of `qp`, or None, warm-started from `start` and `duals`; `duals` is updated in place.

        `start` may omit the last unknowns, the slacks, which are then 0.
        """
        qp = self.qp
        numbers = {"Ax": qp.matrix.data} if qp.rows else {}
        self._osqp.update(q=qp.gradient, l=qp.lower, u=qp.upper, Px=qp.hessian.data, **numbers)
        unknowns = np.zeros(len(qp.gradient))
        unknowns[: len(start)] = start
        self._osqp.warm_start(x=unknowns, y=duals[: len(qp.lower)])
        result = self._osqp.solve(raise_error=False)
        self.iterations = int(result.info.iter)
        if result.info.status_val not in USABLE or not np.isfinite(result.x).all():
            return None
        duals[: len(qp.lower)] = result.y
        return np.asarray(result.x)


class _Linearisation:
    """A motion, its exact cost, and a quadratic model of the cost around it."""

    def __init__(self, controller: ReachMpc, parameters: OcpParameters, motion: JointTrajectory) -> None:
        self.problem, self.parameters, self.motion = controller.problem, parameters, motion
        options, q = controller.options, motion.positions[1:]
        distances = np.full(len(q), np.inf)
        size = parameters.targets.shape[1]
        self.knots = kernel.Knots(q, np.empty((len(q), size)), np.empty((*q.shape, 3)), np.empty((*q.shape, size)))
        kernel.evaluate_knots(controller.scene, parameters.targets, self.knots, distances)
        self.cost = self.merit = cost(self.problem, parameters, motion, self.knots.errors)
        """m^2; the merit has the penalty for violated margins too"""
        self.min_distance = float(distances.min())
        """m: least distance"""
        if self.min_distance < options.margin:
            self.merit += options.slack_penalty * float(np.maximum(options.margin - distances, 0.0).sum())

    def quadratic_model(self) -> tuple[Array, Array]:
        """Return convex Hessians (N, dof, dof) and gradients (N, dof), at q = 0, of the cost of the knots' places."""
        shape = self.knots.q.shape
        hessians, slopes = np.empty((*shape, shape[1])), np.empty(shape)
        posture, weight = self.parameters.preference(self.problem)
        exact = bool(np.abs(self.knots.errors).max() >= NEARBY)
        kernel.quadratic_model(self.knots, exact, weight, posture, hessians, slopes)
        return hessians, slopes
