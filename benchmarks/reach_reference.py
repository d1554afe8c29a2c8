"""A `ReachProblem` solved to convergence: the reference for `ReachMpc`, without a time limit.

CasADi writes the nonlinear program with its exact derivatives (Andersson et al., "CasADi: a software framework for
nonlinear optimization and optimal control", Mathematical Programming Computation 11, 2019), with the forward kinematics
from the same URDF. IPOPT solves it (Waechter and Biegler, Mathematical Programming 106, 2006). Obstacles are ignored.
"""

import time
from typing import Any

import casadi
import numpy as np
from numpy.typing import ArrayLike

from armctl.control.reach_problem import (
    JointTrajectory,
    MpcResult,
    OcpParameters,
    ReachProblem,
    braking,
    cost,
    project_onto_limits,
    stopping_times,
)
from armctl.core.arrays import Array
from armctl.kinematics import ArmModel

TOLERANCE = 1e-9
"""IPOPT's tolerance, relative to the problem's scale."""
MAX_ITERATIONS = 500


class ReachReference:
    """Locally optimal plans of one arm."""

    def __init__(self, model: ArmModel, problem: ReachProblem | None = None) -> None:
        self.model = model
        self.problem = problem or ReachProblem()
        self._solver: Any = None

    def plan(
        self, position: ArrayLike, velocity: ArrayLike, targets: ArrayLike, posture: ArrayLike | None = None,
        start: JointTrajectory | None = None,
    ) -> MpcResult:  # fmt: skip
        """Plan as `ReachMpc.plan`, with the motion `start` as initial guess; by default, braking."""
        began = time.perf_counter()
        problem, limits, dof = self.problem, self.model.limits, self.model.dof
        parameters = OcpParameters.checked(problem, dof, position, velocity, targets, posture)
        worst = braking(problem, limits, parameters)
        guess = start or worst
        self._solver = self._solver or self._built()
        stop = worst.positions[-1]
        target_posture = np.zeros(dof) if parameters.posture is None else parameters.posture
        weight = 0.0 if parameters.posture is None else problem.posture
        solution = self._solver(
            x0=_stacked(guess.positions, guess.velocities),
            p=np.concatenate(
                (parameters.position, parameters.velocity, target_posture, [weight], parameters.targets.ravel())
            ),
            lbx=_stacked(np.minimum(limits.lower, worst.positions), np.minimum(-limits.velocity, worst.velocities)),
            ubx=_stacked(np.maximum(limits.upper, worst.positions), np.maximum(limits.velocity, worst.velocities)),
            lbg=self._rows(-limits.acceleration, np.minimum(limits.lower, stop)),
            ubg=self._rows(limits.acceleration, np.maximum(limits.upper, stop)),
        )
        statistics = self._solver.stats()
        velocities = np.array(solution["x"].full()).reshape(2, problem.horizon, dof)[1]
        motion = project_onto_limits(
            problem, limits, parameters, np.concatenate((parameters.velocity[None], velocities))
        )
        return MpcResult(
            motion.positions, motion.velocities, motion.accelerations,
            reach_cost(self.model, problem, parameters, motion), np.inf, bool(statistics["success"]),
            int(statistics["iter_count"]), time.perf_counter() - began,
        )  # fmt: skip

    def _rows(self, change: Array, last: Array) -> Array:
        """Return bounds of the constraints: dynamics, accelerations, and the stop after the last knot."""
        return np.concatenate(
            (np.zeros(self.problem.horizon * self.model.dof), np.tile(change, self.problem.horizon), last)
        )

    def _built(self) -> Any:
        problem, dof, knots = self.problem, self.model.dof, self.problem.horizon
        q, v = casadi.SX.sym("q", dof, knots), casadi.SX.sym("v", dof, knots)
        position, velocity, posture = (casadi.SX.sym(name, dof) for name in ("now", "velocity", "posture"))
        weight, targets = casadi.SX.sym("weight"), casadi.SX.sym("targets", 3, knots)
        previous, speed_before = casadi.horzcat(position, q[:, :-1]), casadi.horzcat(velocity, v[:, :-1])
        acceleration = (v - speed_before) / problem.period
        tips = casadi.horzcat(*(symbolic_position(self.model, q[:, k]) for k in range(knots)))
        total = casadi.sumsqr(tips - targets) + problem.velocity * casadi.sumsqr(v)
        total += problem.acceleration * casadi.sumsqr(acceleration)
        total += weight * casadi.sumsqr(q - casadi.repmat(posture, 1, knots))
        last = q[:, -1] + stopping_times(self.model.limits) * v[:, -1]
        dynamics = q - previous - (v + speed_before) * (problem.period / 2)
        program = {
            "x": casadi.vertcat(casadi.vec(q), casadi.vec(v)),
            "p": casadi.vertcat(position, velocity, posture, weight, casadi.vec(targets)),
            "f": total,
            "g": casadi.vertcat(casadi.vec(dynamics), casadi.vec(acceleration), last),
        }
        quiet: Any = {"print_level": 0, "sb": "yes", "tol": TOLERANCE, "max_iter": MAX_ITERATIONS}
        return casadi.nlpsol("reach", "ipopt", program, {"print_time": False, "ipopt": quiet})


def reach_cost(model: ArmModel, problem: ReachProblem, parameters: OcpParameters, motion: JointTrajectory) -> float:
    """Return the cost of a motion, m^2."""
    return cost(problem, parameters, motion, model.positions(motion.positions[1:]) - parameters.targets)


def symbolic_position(model: ArmModel, q: Any) -> Any:
    """Return the symbolic end-effector position (3,) m at CasADi's symbols q (dof,)."""
    rotation, position = casadi.SX.eye(3), casadi.SX.zeros(3)
    for i, (placement, axis) in enumerate(zip(model.pinocchio.jointPlacements[1:], model.axes, strict=True)):
        cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        position = position + rotation @ placement.translation
        turn = np.eye(3) + casadi.sin(q[i]) * cross + (1 - casadi.cos(q[i])) * (cross @ cross)
        rotation = rotation @ placement.rotation @ turn
    return position + rotation @ model.pinocchio.frames[model.tip].placement.translation


def _stacked(positions: Array, velocities: Array) -> Array:
    """Return the knots after the current state, in the order of the program's unknowns."""
    return np.concatenate((positions[1:].ravel(), velocities[1:].ravel()))
