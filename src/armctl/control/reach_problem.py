"""The optimal control problem of reaching, which the fast controller and its reference share.

    minimise   sum over k = 1..N of  |p(q_k) - target_k|^2 + posture |q_k - goal|^2 + velocity |v_k|^2
             + sum over k < N of     acceleration |a_k|^2

for joints whose acceleration is constant within a period T: v_k+1 = v_k + T a_k, q_k+1 = q_k + T (v_k + v_k+1) / 2.
They keep their position, velocity and acceleration limits, and end where they can still stop before the former.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.errors import ConfigurationError
from armctl.kinematics import ArmModel
from armctl.robot_description.joint_profiles import MotionLimits

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReachProblem:
    """Horizon and weights. Raises `ConfigurationError` for values it cannot take."""

    horizon: int = 20
    """N, periods."""
    period: float = 0.04
    """T, s."""
    posture: float = 5e-4
    """Weight of a joint's distance from the posture asked for, m^2/rad^2: 0.4 rad count as 1 cm of the tip."""
    velocity: float = 1e-4
    """Weight of joint velocity, m^2 s^2/rad^2: 1 rad/s counts as 1 cm."""
    acceleration: float = 1e-5
    """Weight of joint acceleration, m^2 s^4/rad^2: 3 rad/s^2 count as 1 cm."""

    def __post_init__(self) -> None:
        if not (isinstance(self.horizon, int) and self.horizon >= 2):
            raise ConfigurationError(f"a horizon is a whole number of periods, at least 2, not {self.horizon!r}")
        if not (np.isfinite(self.period) and self.period > 0):
            raise ConfigurationError(f"a period is a finite time above 0 s, not {self.period!r}")
        for name in ("posture", "velocity", "acceleration"):
            weight = getattr(self, name)
            if not (np.isfinite(weight) and weight >= 0):
                raise ConfigurationError(f"the weight of {name} is a finite number of at least 0, not {weight!r}")


@dataclass(frozen=True, eq=False)
class OcpParameters:
    """Where the joints are, and what is asked of them."""

    position: Array
    """(dof,) rad."""
    velocity: Array
    """(dof,) rad/s."""
    targets: Array
    """(N, 3) m, at the end of each period."""
    posture: Array | None
    """(dof,) rad, if any is asked for."""

    @classmethod
    def checked(
        cls, problem: ReachProblem, dof: int, position: ArrayLike, velocity: ArrayLike, targets: ArrayLike,
        posture: ArrayLike | None,
    ) -> "OcpParameters":  # fmt: skip
        """From what a caller gave; one target (3,) stands still. Raises `ConfigurationError` for what is amiss."""
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
    """What the joints do over the horizon."""

    positions: Array
    """(N + 1, dof) rad, the first is the present."""
    velocities: Array
    """(N + 1, dof) rad/s."""
    accelerations: Array
    """(N, dof) rad/s^2."""


@dataclass(frozen=True, eq=False)
class MpcResult(JointTrajectory):
    """A plan, and what it was measured to be."""

    cost: float
    """By the exact nonlinear kinematics, m^2, without what obstacles add."""
    clearance: float
    """Least distance of the arm from what it must not touch, over the plan, m; infinite if nothing was near."""
    solved: bool
    """Whether the solver found it. If not, the joints brake."""
    iterations: int
    """Of the solver, over all quadratic programs of the plan."""
    seconds: float
    """That it took to find."""


def cost(problem: ReachProblem, situation: OcpParameters, motion: JointTrajectory, tips: Array) -> float:
    """What a motion costs whose end-effector passes `tips` (N, 3) m, in m^2."""
    error = tips - situation.targets
    total = (error * error).sum() + problem.velocity * (motion.velocities[1:] ** 2).sum()
    total += problem.acceleration * (motion.accelerations**2).sum()
    if situation.posture is not None:
        total += problem.posture * ((motion.positions[1:] - situation.posture) ** 2).sum()
    return float(total)


def reach_cost(model: ArmModel, problem: ReachProblem, situation: OcpParameters, motion: JointTrajectory) -> float:
    """What a motion costs, m^2."""
    return cost(problem, situation, motion, model.positions(motion.positions[1:]))


def stopping_times(limits: MotionLimits) -> Array:
    """Seconds (dof,) such that position + velocity * seconds within the limits can be kept up for ever.

    A joint of velocity v that brakes at its limit a for a period T moves by T (v - T a / 2), and v * seconds falls by
    T a * seconds: enough at all velocities if seconds = (highest velocity) / a. (The parabola v^2 / 2 a is not convex
    as a constraint.)
    """
    return np.asarray(limits.velocity / limits.acceleration)


def braking(problem: ReachProblem, limits: MotionLimits, situation: OcpParameters) -> JointTrajectory:
    """All joints brake at their acceleration limits, and stay."""
    change = limits.acceleration * problem.period
    falls = np.arange(problem.horizon + 1)[:, None] * change
    velocities = np.copysign(np.maximum(np.abs(situation.velocity) - falls, 0.0), situation.velocity)
    return rolled_out(problem, situation.position, velocities)


def straight_to(problem: ReachProblem, limits: MotionLimits, situation: OcpParameters, goal: Array) -> JointTrajectory:
    """Each joint goes to `goal` (dof,) as soon as it can, and stops there."""
    period = problem.period
    joints = (situation.position, situation.velocity, goal, limits.velocity, limits.acceleration)
    velocities = []
    for position, velocity, end, highest, acceleration in np.transpose(joints).tolist():
        joint = [velocity]
        for _ in range(problem.horizon):
            way = end - position - velocity * period / 2
            fastest = acceleration * (math.sqrt(period**2 + 2 * abs(way) / acceleration) - period)
            wanted = math.copysign(min(fastest, highest), way)
            next_velocity = min(max(wanted, velocity - acceleration * period), velocity + acceleration * period)
            position += (velocity + next_velocity) * period / 2
            velocity = next_velocity
            joint.append(velocity)
        velocities.append(joint)
    return project_onto_limits(problem, limits, situation, np.array(velocities).T)


def rolled_out(problem: ReachProblem, position: Array, velocities: Array) -> JointTrajectory:
    """The motion (N + 1, dof) of given velocities from `position` on."""
    ways = (velocities[:-1] + velocities[1:]) * (problem.period / 2)
    positions = np.concatenate((position[None], position + np.cumsum(ways, axis=0)))
    return JointTrajectory(positions, velocities, np.diff(velocities, axis=0) / problem.period)


def project_onto_limits(
    problem: ReachProblem, limits: MotionLimits, situation: OcpParameters, wanted: Array
) -> JointTrajectory:
    """The motion near to velocities `wanted` (N + 1, dof) that keeps the limits, as far as the start allows."""
    change = limits.acceleration * problem.period
    changes = np.minimum(np.maximum(np.diff(wanted, axis=0), -change), change)
    velocities = np.concatenate((situation.velocity[None], situation.velocity + np.cumsum(changes, axis=0)))
    velocities[1:] = np.minimum(np.maximum(velocities[1:], -limits.velocity), limits.velocity)
    motion = rolled_out(problem, situation.position, velocities)
    stops = motion.positions[-1] + _stopping_way(problem, limits, velocities[-1])
    places = np.concatenate((motion.positions, stops[None]))
    if (places >= limits.lower).all() and (places <= limits.upper).all():
        return motion
    return _stoppable(problem, limits, situation, velocities)


def _stopping_way(problem: ReachProblem, limits: MotionLimits, velocity: Array) -> Array:
    """A bound on how far joints go until they stop, in whole periods of constant acceleration."""
    return np.asarray(velocity * (np.abs(velocity) / (2 * limits.acceleration) + problem.period / 2))


def _stoppable(problem: ReachProblem, limits: MotionLimits, situation: OcpParameters, wanted: Array) -> JointTrajectory:
    """As `wanted` (N + 1, dof), but no faster than a stop before the position limits allows."""
    period, acceleration = problem.period, limits.acceleration
    velocities, position = wanted.copy(), situation.position
    for k in range(problem.horizon):
        now = velocities[k]
        fastest = _fastest(limits.upper - position - now * period / 2, period, acceleration)
        slowest = -_fastest(position + now * period / 2 - limits.lower, period, acceleration)
        velocity = np.clip(np.clip(wanted[k + 1], slowest, fastest), -limits.velocity, limits.velocity)
        velocities[k + 1] = np.clip(velocity, now - acceleration * period, now + acceleration * period)
        position = position + (now + velocities[k + 1]) * period / 2
    return rolled_out(problem, situation.position, velocities)


def _fastest(room: Array, period: float, acceleration: Array) -> Array:
    """The highest velocity at the end of a period that leaves `room` for its second half, and to stop thereafter."""
    return np.asarray(acceleration * (np.sqrt(period**2 + 2 * np.maximum(room, 0.0) / acceleration) - period))


def _array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"{name} is an array {shape} of numbers, not {value!r}") from error
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigurationError(f"{name} is an array {shape} of finite numbers, not {array}")
    return array
