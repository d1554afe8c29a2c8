"""Model-predictive control of an arm: where its joints go over the next second, decided anew each period.

The real-time iteration (Diehl, Bock, Schloeder: "A real-time iteration scheme for nonlinear optimization in optimal
feedback control", SIAM J. Control and Optimization 43, 2005): the last plan, shifted by a period, is where the problem
is linearised, and a quadratic program away from it lies the next. OSQP solves that (Stellato et al., "OSQP: an operator
splitting solver for quadratic programs", Mathematical Programming Computation 12, 2020) from the last solution on.

Two things make a few such steps enough. The Hessian is the exact one of each knot, made convex (Verschueren et al., "A
sparsity preserving convexification procedure for indefinite quadratic programs arising in direct optimal control", SIAM
J. Optimization 27, 2017), for far from the target Gauss and Newton's misleads; and the first plan leads straight to the
posture asked for.
"""

import time
from dataclasses import dataclass, field

import numpy as np
import osqp
from numpy.typing import ArrayLike, NDArray

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
from armctl.errors import ConfigurationError
from armctl.kinematics import ArmModel
from armctl.kinematics.clearance import Clearance
from armctl.kinematics.model import cross

Array = NDArray[np.float64]

RELAXATION = 1.8
"""Of the solver (alpha): near 2, as Stellato et al. advise."""
NEARBY = 0.15
"""m from the targets, within which Gauss and Newton's Hessian does."""
STEPS = (1.0, 0.3)
"""Parts of the way to a program's solution that are tried, the longest first."""
USABLE = (
    osqp.SolverStatus.OSQP_SOLVED,
    osqp.SolverStatus.OSQP_SOLVED_INACCURATE,
    osqp.SolverStatus.OSQP_MAX_ITER_REACHED,
)
"""What the solver may end with. An unfinished solution too is a direction, and the next decision goes on from it."""


@dataclass(frozen=True)
class ReachMpcOptions:
    """Effort of the controller."""

    problem: ReachProblem = field(default_factory=ReachProblem)
    max_sqp_iterations: int = 2
    """Most quadratic programs for a first plan. Those that begin at another have one."""
    cost_tolerance: float = 1e-2
    """Part of the cost below which a program's gain ends the search for a first plan."""
    max_iterations: int = 15
    """Of the solver, for each program."""
    tolerance: float = 1e-4
    """Of the solver, absolute and relative."""
    step_size: float = 0.1
    """The solver's rho."""
    pairs: int = 4
    """How many of the nearest pairs of links, floor and boxes each knot minds; with 0, none."""
    margin: float = 0.03
    """m that they shall keep between them: between knots and points of links, they come nearer than there."""
    influence_distance: float = 0.15
    """m from which on they are minded: no knot comes nearer than that by one program from further away."""
    slack_penalty: float = 50.0
    """m^2 for each m that a knot is too near: above what a shorter way could save, so that none is taken."""

    def __post_init__(self) -> None:
        for name, least in (("max_sqp_iterations", 1), ("max_iterations", 1), ("pairs", 0)):
            if not (isinstance(getattr(self, name), int) and getattr(self, name) >= least):
                raise ConfigurationError(f"{name} is a whole number of at least {least}, not {getattr(self, name)!r}")
        for name in ("cost_tolerance", "tolerance", "step_size", "margin", "influence_distance", "slack_penalty"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise ConfigurationError(f"{name} is a finite number above 0, not {getattr(self, name)!r}")


class ReachMpc:
    """Plans the motion of one arm's end-effector to targets, decision by decision."""

    def __init__(self, model: ArmModel, options: ReachMpcOptions | None = None) -> None:
        self.model = model
        self.options = options or ReachMpcOptions()
        self.problem = self.options.problem
        self.failures = 0
        """Programs that the solver did not solve, since the controller was made."""
        self._open = _Solver(self.options, model, rows=0)
        self._tight = _Solver(self.options, model, self.options.pairs) if self.options.pairs else self._open
        self.clearance = Clearance(model)
        self.reset()

    def reset(self) -> None:
        """Forget the last plan: what comes is another episode."""
        self._last: JointTrajectory | None = None
        self._posture: Array | None = None
        self._duals = self._tight.qp.first_duals()

    def begin(self, position: ArrayLike, velocity: ArrayLike, posture: ArrayLike) -> JointTrajectory:
        """The straight way to a posture (dof,), rad, at which the next plan begins. It takes a tenth of the time.

        Raises `ConfigurationError` as `plan` does.
        """
        no_target = np.zeros(3)
        situation = OcpParameters.checked(self.problem, self.model.dof, position, velocity, no_target, posture)
        assert situation.posture is not None
        self.reset()
        self._last = straight_to(self.problem, self.model.limits, situation, situation.posture)
        self._posture = situation.posture
        return self._last

    def plan(
        self, position: ArrayLike, velocity: ArrayLike, targets: ArrayLike, posture: ArrayLike | None = None
    ) -> MpcResult:
        """The motion from joint `position` (dof,) rad and `velocity` (dof,) rad/s on.

        `targets` (N, 3) m are where the end-effector should be at the end of each period; (3,) is one at rest.
        `posture` (dof,) rad is where joints should rather be: from a global search, for this one is local.
        Raises `ConfigurationError` for arguments of other shapes, or not finite.
        """
        began = time.perf_counter()
        situation = OcpParameters.checked(self.problem, self.model.dof, position, velocity, targets, posture)
        worst = braking(self.problem, self.model.limits, situation)
        best = self._first_guess(situation, worst)
        iterations, solved = 0, True
        for _ in range(self.options.max_sqp_iterations if self._last is None else 1):
            velocities, spent = self._solve(situation, worst, best)
            iterations += spent
            if velocities is None:
                self.failures += 1
                self.reset()
                best, solved = _Linearisation(self, situation, worst), False
                break
            gain, best = self._towards(situation, best, velocities)
            if gain <= self.options.cost_tolerance * best.merit:
                break
        if solved:
            best = self._safe(situation, worst, best)
            self._last, self._posture = best.motion, situation.posture
        motion = best.motion
        return MpcResult(
            motion.positions, motion.velocities, motion.accelerations,
            best.cost, best.least, solved, iterations, time.perf_counter() - began,
        )  # fmt: skip

    def _first_guess(self, situation: OcpParameters, worst: JointTrajectory) -> "_Linearisation":
        """The last plan shifted by a period; where there is none for this posture, the straight way to it."""
        limits, guesses = self.model.limits, []
        if self._last is not None:
            shifted = np.concatenate((self._last.velocities[1:], self._last.velocities[-1:]))
            guesses.append(project_onto_limits(self.problem, limits, situation, shifted))
            self._tight.qp.shift(self._duals)
        goal, known = situation.posture, self._posture
        if goal is not None and (known is None or not np.array_equal(known, goal)):
            guesses.append(straight_to(self.problem, limits, situation, goal))
        linearised = [_Linearisation(self, situation, guess) for guess in guesses or [worst]]
        return min(linearised, key=lambda one: one.merit)

    def _safe(self, situation: OcpParameters, worst: JointTrajectory, best: "_Linearisation") -> "_Linearisation":
        """The plan, unless after its first period it would be too late to brake before an obstacle: then braking.

        Few iterations may not yet have led a plan around what is on its way.
        """
        enough = self.options.margin / 2
        if best.least >= enough:
            return best
        first, falls = best.motion.velocities[1], self.model.limits.acceleration * self.problem.period
        speeds = np.maximum(np.abs(first) - np.arange(self.problem.horizon)[:, None] * falls, 0.0)
        velocities = np.concatenate((situation.velocity[None], np.copysign(speeds, first)))
        later = _Linearisation(
            self, situation, project_onto_limits(self.problem, self.model.limits, situation, velocities)
        )
        if later.least >= enough:
            return best
        now = _Linearisation(self, situation, worst)
        return now if now.least > later.least else best

    def _solve(
        self, situation: OcpParameters, worst: JointTrajectory, at: "_Linearisation"
    ) -> tuple[Array | None, int]:
        """Velocities (N + 1, dof) by the program linearised at a motion, None if it was not solved; and iterations."""
        solver = self._tight if at.least < self.options.influence_distance else self._open
        qp = solver.qp
        qp.write(situation, worst, *at.quadratic_model())
        if qp.rows:
            distances, normals = at.nearest.rows
            least = self.options.margin - distances + (normals @ at.q[..., None])[..., 0]
            qp.write_obstacles(normals, least)
        motion = at.motion
        ways = motion.velocities[1:] * self.problem.period
        found = solver.solve(np.concatenate((motion.positions[1:].ravel(), ways.ravel())), self._duals)
        if found is None:
            return None, solver.iterations
        ways = found[qp.states : 2 * qp.states].reshape(-1, self.model.dof)
        return np.concatenate((situation.velocity[None], ways / self.problem.period)), solver.iterations

    def _towards(
        self, situation: OcpParameters, best: "_Linearisation", velocities: Array
    ) -> tuple[float, "_Linearisation"]:
        """The gain in cost, and the motion, of the longest step towards `velocities` that makes it cheaper."""
        for step in STEPS:
            wanted = best.motion.velocities + step * (velocities - best.motion.velocities)
            motion = project_onto_limits(self.problem, self.model.limits, situation, wanted)
            found = _Linearisation(self, situation, motion)
            if found.merit < best.merit:
                return best.merit - found.merit, found
        return 0.0, best


class _Solver:
    """OSQP for programs of one pattern."""

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
        """The solution of what was written, or None, from `start` and `duals` on, which it brings up to date.

        `start` may leave out the last unknowns, the slacks, for none.
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
    """A motion, its exact cost, and what that is nearby."""

    def __init__(self, controller: ReachMpc, situation: OcpParameters, motion: JointTrajectory) -> None:
        self.problem, self.situation, self.motion = controller.problem, situation, motion
        model, options = controller.model, controller.options
        self.q = motion.positions[1:]
        frames = model.joint_frames(self.q)
        tips = model.tip_positions(frames)
        self.error = tips - situation.targets
        self.cost = cost(self.problem, situation, motion, tips)
        self.merit, self.least = self.cost, np.inf
        """The cost with what nearness adds, m^2; the least distance, m."""
        if options.pairs:
            self.nearest = controller.clearance.nearest(frames, model.boxes, options.pairs)
            self.least = float(self.nearest.least.min())
            self.merit += options.slack_penalty * float(np.maximum(options.margin - self.nearest.least, 0.0).sum())
        self.axes = model.joint_axes(frames)
        self.gradients = cross(self.axes, tips[:, None] - frames[..., :3, 3])
        """(N, dof, 3) of the tip's position by each joint."""

    def quadratic_model(self) -> tuple[Array, Array]:
        """Hessians (N, dof, dof), made convex, and gradients (N, dof) at q = 0 of what the knots' positions cost."""
        slope = self.gradients @ self.error[..., None]
        squares = self.gradients @ np.swapaxes(self.gradients, -1, -2)
        if np.abs(self.error).max() < NEARBY:
            hessians = 2 * squares
        else:
            # the tip's second derivative by joints i <= j is axis_i x (its first by j)
            bend = self.axes @ np.swapaxes(cross(self.gradients, self.error[:, None]), -1, -2)
            bend = np.triu(bend) + np.swapaxes(np.triu(bend, 1), -1, -2)
            values, vectors = np.linalg.eigh(squares + bend)
            hessians = 2 * (vectors * np.maximum(values, 0.0)[:, None]) @ np.swapaxes(vectors, -1, -2)
        gradients = 2 * slope[..., 0] - (hessians @ self.q[..., None])[..., 0]
        if self.situation.posture is not None:
            hessians += 2 * self.problem.posture * np.eye(self.q.shape[1])
            gradients -= 2 * self.problem.posture * self.situation.posture
        return hessians, gradients
