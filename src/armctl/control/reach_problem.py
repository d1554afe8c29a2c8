"""The optimal control problem of reaching, shared by the real-time controller and its reference.

    minimise   sum over k = 1..N of  |p(q_k) - target_k|^2 + posture |q_k - goal|^2 + velocity |v_k|^2
             + sum over k < N of     acceleration |a_k|^2

with accelerations constant within a period T: v_k+1 = v_k + T a_k, q_k+1 = q_k + T (v_k + v_k+1) / 2. Position,
velocity and acceleration are limited, and at the end joints can still stop before their position limits.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from armctl.errors import ConfigurationError
from armctl.kinematics import ArmModel
from armctl.options import options
from armctl.robot_description.joint_profiles import MotionLimits

Array = NDArray[np.float64]
Weight = Annotated[float, Field(ge=0)]


@options
class ReachProblem:
    """Horizon and weights."""

    horizon: Annotated[int, Field(ge=2)] = 20
    """N, periods"""
    period: Annotated[float, Field(gt=0)] = 0.04
    """T, s"""
    posture: Weight = 5e-4
    """Weight of a joint's distance from the posture, m^2/rad^2: 0.4 rad count as 1 cm of the tip."""
    velocity: Weight = 1e-4
    """Weight of joint velocity, m^2 s^2/rad^2: 1 rad/s counts as 1 cm."""
    acceleration: Weight = 1e-5
    """Weight of joint acceleration, m^2 s^4/rad^2: 3 rad/s^2 count as 1 cm."""


@dataclass(frozen=True, eq=False)
class OcpParameters:
    """The initial state of the joints, the targets and the posture."""

    position: Array
    """(dof,) rad."""
    velocity: Array
    """(dof,) rad/s."""
    targets: Array
    """(N, 3) m, at the end of each period."""
    posture: Array | None
    """(dof,) rad: preferred joint positions, if any."""

    @classmethod
    def checked(
        cls, problem: ReachProblem, dof: int, position: ArrayLike, velocity: ArrayLike, targets: ArrayLike,
        posture: ArrayLike | None,
    ) -> "OcpParameters":  # fmt: skip
        """Validate arguments; one target (3,) is at rest. Raises `ConfigurationError` for invalid ones."""
        if np.shape(targets) == (3,):
            targets = np.tile(targets, (problem.horizon, 1))
        return cls(
            _array("position", position, (dof,)),
            _array("velocity", velocity, (dof,)),
            _array("targets", targets, (problem.horizon, 3)),
            None if posture is None else _array("posture", posture, (dof,)),
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
    """Whether the solver succeeded. If not, the joints brake."""
    iterations: int
    """Solver iterations, over all quadratic programs."""
    seconds: float
    """Planning time."""


def cost(problem: ReachProblem, parameters: OcpParameters, motion: JointTrajectory, tips: Array) -> float:
    """Cost (m^2) of a motion whose end-effector passes through `tips` (N, 3) m."""
    error = tips - parameters.targets
    total = (error * error).sum() + problem.velocity * (motion.velocities[1:] ** 2).sum()
    total += problem.acceleration * (motion.accelerations**2).sum()
    if parameters.posture is not None:
        total += problem.posture * ((motion.positions[1:] - parameters.posture) ** 2).sum()
    return float(total)


def reach_cost(model: ArmModel, problem: ReachProblem, parameters: OcpParameters, motion: JointTrajectory) -> float:
    """Cost of a motion, m^2."""
    return cost(problem, parameters, motion, model.positions(motion.positions[1:]))


def stopping_times(limits: MotionLimits) -> Array:
    """Seconds (dof,) s such that position + velocity * s, once within the limits, can be kept within them for ever.

    A joint of velocity v that brakes at its limit a for a period T moves by T (v - T a / 2), while v * s falls by
    T a * s. That suffices at all velocities if s = (maximum velocity) / a. (The exact bound v^2 / 2 a is not convex.)
    """
    return np.asarray(limits.velocity / limits.acceleration)


def braking(problem: ReachProblem, limits: MotionLimits, parameters: OcpParameters) -> JointTrajectory:
    """All joints brake at their acceleration limits until they stop."""
    change = limits.acceleration * problem.period
    falls = np.arange(problem.horizon + 1)[:, None] * change
    velocities = np.copysign(np.maximum(np.abs(parameters.velocity) - falls, 0.0), parameters.velocity)
    return rolled_out(problem, parameters.position, velocities)


def straight_to(problem: ReachProblem, limits: MotionLimits, parameters: OcpParameters, goal: Array) -> JointTrajectory:
    """Each joint moves to `goal` (dof,) in minimum time, and stops there."""
    period = problem.period
    joints = (parameters.position, parameters.velocity, goal, limits.velocity, limits.acceleration)
    velocities = []
    for position, velocity, end, highest, acceleration in np.transpose(joints).tolist():
        joint = [velocity]
        for _ in range(problem.horizon):
            distance = end - position - velocity * period / 2
            fastest = acceleration * (math.sqrt(period**2 + 2 * abs(distance) / acceleration) - period)
            wanted = math.copysign(min(fastest, highest), distance)
            next_velocity = min(max(wanted, velocity - acceleration * period), velocity + acceleration * period)
            position += (velocity + next_velocity) * period / 2
            velocity = next_velocity
            joint.append(velocity)
        velocities.append(joint)
    return project_onto_limits(problem, limits, parameters, np.array(velocities).T)


def rolled_out(problem: ReachProblem, position: Array, velocities: Array) -> JointTrajectory:
    """The motion with `velocities` (N + 1, dof) from `position` (dof,)."""
    displacements = (velocities[:-1] + velocities[1:]) * (problem.period / 2)
    positions = np.concatenate((position[None], position + np.cumsum(displacements, axis=0)))
    return JointTrajectory(positions, velocities, np.diff(velocities, axis=0) / problem.period)


def project_onto_limits(
    problem: ReachProblem, limits: MotionLimits, parameters: OcpParameters, wanted: Array
) -> JointTrajectory:
    """The motion near velocities `wanted` (N + 1, dof) that keeps the limits, as far as the initial state allows."""
    change = limits.acceleration * problem.period
    changes = np.minimum(np.maximum(np.diff(wanted, axis=0), -change), change)
    velocities = np.concatenate((parameters.velocity[None], parameters.velocity + np.cumsum(changes, axis=0)))
    velocities[1:] = np.minimum(np.maximum(velocities[1:], -limits.velocity), limits.velocity)
    motion = rolled_out(problem, parameters.position, velocities)
    stops = motion.positions[-1] + _stopping_distance(problem, limits, velocities[-1])
    extremes = np.concatenate((motion.positions, stops[None]))
    if (extremes >= limits.lower).all() and (extremes <= limits.upper).all():
        return motion
    return _stoppable(problem, limits, parameters, velocities)


def _stopping_distance(problem: ReachProblem, limits: MotionLimits, velocity: Array) -> Array:
    """Bound on the displacement until joints stop, in whole periods of constant acceleration."""
    return np.asarray(velocity * (np.abs(velocity) / (2 * limits.acceleration) + problem.period / 2))


def _stoppable(
    problem: ReachProblem, limits: MotionLimits, parameters: OcpParameters, wanted: Array
) -> JointTrajectory:
    """As `wanted` (N + 1, dof), but slow enough to stop before the position limits."""
    period, acceleration = problem.period, limits.acceleration
    velocities, position = wanted.copy(), parameters.position
    for k in range(problem.horizon):
        now = velocities[k]
        fastest = _fastest(limits.upper - position - now * period / 2, period, acceleration)
        slowest = -_fastest(position + now * period / 2 - limits.lower, period, acceleration)
        velocity = np.clip(np.clip(wanted[k + 1], slowest, fastest), -limits.velocity, limits.velocity)
        velocities[k + 1] = np.clip(velocity, now - acceleration * period, now + acceleration * period)
        position = position + (now + velocities[k + 1]) * period / 2
    return rolled_out(problem, parameters.position, velocities)


def _fastest(room: Array, period: float, acceleration: Array) -> Array:
    """The highest velocity at the end of a period from which a joint stops within `room`, half the period included."""
    return np.asarray(acceleration * (np.sqrt(period**2 + 2 * np.maximum(room, 0.0) / acceleration) - period))


def _array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"{name} should be an array {shape} of numbers, not {value!r}") from error
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigurationError(f"{name} should be an array {shape} of finite numbers, not {array}")
    return array
