"""A plan's next period, as the position command that makes an arm's drives do it.

The drives (`armctl.robot_description.joint_profiles`) take a position to move to, and go there by their own law. The law is simulated here, so
that a controller knows where its command is without being told, and searched for the position that leads where it wants
to be.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.control.reach_problem import JointTrajectory
from armctl.control.trajectory import Trajectory
from armctl.robot_description.joint_profiles import TICK, MotionLimits, limited_in_the_open, towards

Array = NDArray[np.float64]

SHARES = np.linspace(-1.2, 1.2, 49)[:, None]
"""Of the speed that a joint can gain in a period: goals to choose from are where it would then come to a stop."""


def follow(limits: MotionLimits, position: Array, velocity: Array, goal: Array, period: float) -> tuple[Array, Array]:
    """Position (..., dof) rad and velocity (..., dof) rad/s of a command after a `period` (s) on its way to `goal`."""
    for _ in range(max(1, round(period / TICK))):
        velocity = limited_in_the_open(towards(goal, position, limits), velocity, limits)
        position = position + velocity * TICK
    return position, velocity


def command_for(limits: MotionLimits, position: Array, velocity: Array, displacement: Array, period: float) -> Array:
    """The goal (dof,) rad for which drives move by `displacement` (dof,) rad within the next `period` (s).

    They are at `position` (dof,) with `velocity` (dof,). The further the goal, the further they get: where they cannot
    get that far, or not brake before, it is the goal that leads nearest.
    """
    ends = velocity + SHARES * (limits.acceleration * period)
    goals = position + (velocity + ends) / 2 * period + ends * np.abs(ends) / (2 * limits.acceleration)
    goals = np.minimum(np.maximum(goals, limits.lower), limits.upper)
    moved = follow(limits, position, velocity, goals, period)[0] - position
    joints = np.arange(len(position))
    below = np.minimum(np.maximum((moved < displacement).sum(axis=0) - 1, 0), len(SHARES) - 2)
    low, high = goals[below, joints], goals[below + 1, joints]
    before, after = moved[below, joints], moved[below + 1, joints]
    share = (displacement - before) / np.maximum(after - before, 1e-12)
    return np.asarray(low + np.minimum(np.maximum(share, 0.0), 1.0) * (high - low))


class CommandStream:
    """One arm's command, as a plan is turned into goals for its drives, period by period.

    Plan the next period from `position` and `velocity`. The latter is the plan's own, not the drives' at that instant:
    on the way to a goal they speed up and brake again within each period, and only their mean velocity is the plan's.
    """

    def __init__(self, limits: MotionLimits, period: float, position: ArrayLike) -> None:
        self.limits, self.period = limits, period
        self.position: Array = np.array(position, dtype=float)
        """(dof,) rad, where the command is."""
        self.velocity: Array = np.zeros_like(self.position)
        """(dof,) rad/s, what the plan has it at."""
        self._drives: Array = np.zeros_like(self.position)

    def goal(self, motion: JointTrajectory) -> Array:
        """The goal (dof,) rad that makes drives do a plan's first period, after which the command is there."""
        goal = self.goal_towards(motion.positions[1])
        self.velocity = motion.velocities[1]
        return goal

    def goal_towards(self, place: Array) -> Array:
        """The goal (dof,) rad that brings the command to `place` (dof,) rad within the next period, or near to it."""
        goal = command_for(self.limits, self.position, self._drives, place - self.position, self.period)
        self.position, self._drives = follow(self.limits, self.position, self._drives, goal, self.period)
        self.velocity = self._drives
        return goal


def commanded(limits: MotionLimits, motion: Trajectory, period: float) -> Array:
    """Where drives go, (ticks, dof) rad, while they are given the goals that make them follow a `motion`."""
    stream = CommandStream(limits, period, motion.positions[0])
    places = [stream.position]
    for decision in range(1, 2 + math.ceil(motion.duration / period)):
        position, velocity = stream.position, stream._drives
        goal = stream.goal_towards(motion.at(decision * period))
        for _ in range(round(period / TICK)):
            position, velocity = follow(limits, position, velocity, goal, TICK)
            places.append(position)
    return np.array(places)
