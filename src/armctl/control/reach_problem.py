"""The optimal control problem of reaching, shared by the real-time controller and its reference.

    minimise   sum over k = 1..N of  |p(q_k) - target_k|^2 + posture |q_k - goal|^2 + velocity |v_k|^2
             + sum over k < N of     acceleration |a_k|^2

with accelerations constant within a period T: v_k+1 = v_k + T a_k, q_k+1 = q_k + T (v_k + v_k+1) / 2. Position,
velocity and acceleration are limited, and at the end joints can still stop before their position limits.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from armctl.core.arrays import Array, checked_array
from armctl.core.options import NonNegative, Positive, options
from armctl.kernels import reach_mpc
from armctl.robot_description import JointLimits

POSITION, PLACE = 3, 12
"""Numbers of a target: a position, and of a pose also three axes."""


@options
class ReachProblem:
    """Horizon and weights."""

    horizon: Annotated[int, Field(ge=2)] = 20
    """N, periods"""
    period: Positive = 0.04
    """T, s"""
    posture: NonNegative = 5e-4
    """Weight of a joint's distance from the posture, m^2/rad^2: 0.4 rad count as 1 cm of the tip."""
    velocity: NonNegative = 1e-4
    """Weight of joint velocity, m^2 s^2/rad^2: 1 rad/s counts as 1 cm."""
    acceleration: NonNegative = 1e-5
    """Weight of joint acceleration, m^2 s^4/rad^2: 3 rad/s^2 count as 1 cm."""


@dataclass(frozen=True, eq=False)
class OcpParameters:
    """The initial state of the joints, the targets and the posture."""

    position: Array
    """(dof,) rad."""
    velocity: Array
    """(dof,) rad/s."""
    targets: Array
    """(N, 3) m, at the end of each period; (N, 12): the end-effector's three scaled axes too."""
    posture: Array | None
    """(dof,) rad: preferred joint positions, if any."""

    def preference(self, problem: ReachProblem) -> tuple[Array, float]:
        """Return the posture (dof,), rad, and its weight: 0 if there is none."""
        return (self.position, 0.0) if self.posture is None else (self.posture, problem.posture)

    @classmethod
    def checked(
        cls, problem: ReachProblem, dof: int, position: ArrayLike, velocity: ArrayLike, targets: ArrayLike,
        posture: ArrayLike | None,
    ) -> "OcpParameters":  # fmt: skip
        """Validate arguments; one target is at rest. Raises `ConfigurationError` for invalid ones."""
        if np.shape(targets) in ((POSITION,), (PLACE,)):
            targets = np.tile(targets, (problem.horizon, 1))
        size = PLACE if np.shape(targets)[-1:] == (PLACE,) else POSITION
        return cls(
            checked_array("position", position, (dof,)),
            checked_array("velocity", velocity, (dof,)),
            checked_array("targets", targets, (problem.horizon, size)),
            None if posture is None else checked_array("posture", posture, (dof,)),
        )


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """A joint motion over the horizon."""

    positions: Array
    """(N + 1, dof) rad: the first is the current position."""
    velocities: Array
    """(N + 1, dof) rad/s."""
    accelerations: Array
    """(N, dof) rad/s^2."""


@dataclass(frozen=True, eq=False)
class MpcResult(JointTrajectory):
    """A plan with its measured cost, clearance and time."""

    cost: float
    """m^2: by the exact kinematics, without the penalty for obstacles."""
    clearance: float
    """m: least distance from obstacles, floor and the arm itself along the plan; infinite if not computed."""
    solved: bool
    """True if the solver succeeded. If not, the joints brake."""
    iterations: int
    """Solver iterations."""
    seconds: float
    """Planning time."""


def cost(problem: ReachProblem, parameters: OcpParameters, motion: JointTrajectory, errors: Array) -> float:
    """Return the cost (m^2) of a motion whose end-effector misses the targets by `errors` (N, 3 or 12) m."""
    posture, weight = parameters.preference(problem)
    weights = weight, problem.velocity, problem.acceleration
    return float(reach_mpc.cost_of(weights, posture, motion.positions, motion.velocities, motion.accelerations, errors))


def stopping_times(limits: JointLimits) -> Array:
    """Return seconds s (dof,) such that position + velocity * s, once within the limits, can stay within them for ever.

    A joint of velocity v that brakes at its limit a for a period T moves by T (v - T a / 2), while v * s falls by
    T a * s. That suffices at all velocities if s = (maximum velocity) / a. (The exact bound v^2 / 2 a is not convex.)
    """
    return np.asarray(limits.velocity / limits.acceleration)


def braking(problem: ReachProblem, limits: JointLimits, parameters: OcpParameters) -> JointTrajectory:
    """Return the motion of joints that all brake at their acceleration limits until they stop."""
    motion = _empty(problem, parameters)
    reach_mpc.brake(limits.drives, problem.period, parameters.velocity, motion.velocities)
    reach_mpc.roll_out(problem.period, parameters.position, motion.velocities, motion.positions, motion.accelerations)
    return motion


def straight_to(problem: ReachProblem, limits: JointLimits, parameters: OcpParameters, goal: Array) -> JointTrajectory:
    """Return the motion of joints that each move to `goal` (dof,) in minimum time, and stop there."""
    targets = np.empty((problem.horizon + 1, len(goal)))
    reach_mpc.go_straight(limits.drives, problem.period, parameters.position, parameters.velocity, goal, targets)
    return project_onto_limits(problem, limits, parameters, targets)


def project_onto_limits(
    problem: ReachProblem, limits: JointLimits, parameters: OcpParameters, targets: Array
) -> JointTrajectory:
    """Return the motion near velocities `targets` (N + 1, dof) that keeps the limits, if the initial state allows."""
    motion = _empty(problem, parameters)
    reach_mpc.project(
        limits.drives, problem.period, parameters.position, parameters.velocity, targets,
        motion.positions, motion.velocities, motion.accelerations,
    )  # fmt: skip
    return motion


def _empty(problem: ReachProblem, parameters: OcpParameters) -> JointTrajectory:
    """Return memory for a motion."""
    knots, dof = problem.horizon, len(parameters.position)
    return JointTrajectory(np.empty((knots + 1, dof)), np.empty((knots + 1, dof)), np.empty((knots, dof)))
