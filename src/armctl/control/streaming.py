"""The command that makes an arm's drives follow a plan for the next period: a position, or a velocity.

The drives (`armctl.robot_description.joint_profiles`) move to a commanded position or velocity by their own law. That
law is simulated here, so a controller knows where its command is without feedback, and inverted by a search for the
position. A velocity is reached within a period, and what its position lacks is corrected.
"""

import numpy as np
from numpy.typing import ArrayLike

from armctl.control.reach_problem import JointTrajectory
from armctl.core.arrays import Array
from armctl.kernels import drives
from armctl.robot_description import JointLimits
from armctl.robot_description.joint_profiles import TICK

SHARES = np.linspace(-1.2, 1.2, 49)
"""Candidate goals: where a joint stops after it has gained this fraction of its largest speed change per period."""

CORRECTION = 0.5
"""Fraction of an error in position that the next commanded velocity corrects."""


def follow(limits: JointLimits, position: Array, velocity: Array, goal: Array, period: float) -> tuple[Array, Array]:
    """Return position (dof,) rad and velocity (dof,) rad/s of a command after `period` (s) towards `goal` (dof,)."""
    position, velocity = position.copy(), velocity.copy()
    drives.follow_all(limits.drives, goal, position, velocity, max(1, round(period / TICK)), TICK)
    return position, velocity


def command_for(limits: JointLimits, position: Array, velocity: Array, displacement: Array, period: float) -> Array:
    """Return the goal (dof,) rad with which drives move by `displacement` (dof,) rad within the next `period` (s).

    They start at `position` (dof,) with `velocity` (dof,). If no goal gives the displacement, the nearest is taken.
    """
    goal, ticks = np.empty(len(position)), max(1, round(period / TICK))
    drives.goals_for(limits.drives, position, velocity, displacement, SHARES, ticks, TICK, goal)
    return goal


class CommandStream:
    """Turns one arm's plan into goals for its drives, period by period.

    Plan the next period from `position` and `velocity`. The latter is the plan's, not the drives': within a period they
    speed up and brake again, and only their mean velocity is the plan's.
    """

    def __init__(
        self, limits: JointLimits, period: float, position: ArrayLike, velocity: ArrayLike | None = None
    ) -> None:
        self.limits, self.period = limits, period
        self.position: Array = np.array(position, dtype=float)
        """(dof,) rad: the command's position."""
        self.velocity: Array = np.zeros_like(self.position) if velocity is None else np.array(velocity, dtype=float)
        """(dof,) rad/s: the plan's velocity."""
        self._drives: Array = self.velocity.copy()

    def goal(self, motion: JointTrajectory) -> Array:
        """Return the goal (dof,) rad that makes drives execute a plan's first period."""
        goal = self.goal_towards(motion.positions[1])
        self.velocity = motion.velocities[1]
        return goal

    def goal_towards(self, position: Array) -> Array:
        """Return the goal (dof,) rad that brings the command to `position` (dof,) rad in the next period, or near."""
        goal = command_for(self.limits, self.position, self._drives, position - self.position, self.period)
        self.position, self._drives = follow(self.limits, self.position, self._drives, goal, self.period)
        self.velocity = self._drives
        return goal

    def goal_through(self, position: Array, velocity: Array) -> Array:
        """Return the goal (dof,) at which drives stop that pass `position` (dof,) at `velocity` (dof,) rad/s.

        They are there about when the next period ends: other than `goal_towards`, also at their largest acceleration.
        """
        limits = self.limits
        goal = position + velocity * (np.abs(velocity) / (2 * limits.acceleration) + TICK)
        goal = np.clip(goal, limits.lower, limits.upper)
        self.position, self._drives = follow(limits, self.position, self._drives, goal, self.period)
        self.velocity = self._drives
        return goal

    def velocity_through(self, position: Array, velocity: Array) -> Array:
        """Return the velocity (dof,) rad/s to command, for drives that are to be at `position` (dof,) rad with another.

        It is `velocity` (dof,), and what corrects half of the error in position that this leaves.
        """
        error = position - self.position - TICK * self._speeds(velocity).sum(axis=0)
        goal = np.asarray(velocity + CORRECTION * error / self.period)
        speeds = self._speeds(goal)
        self.position, self._drives = self.position + TICK * speeds.sum(axis=0), speeds[-1]
        self.velocity = self._drives
        return goal

    def _speeds(self, velocity: Array) -> Array:
        """Return the velocities (ticks, dof) of drives in the next period, towards `velocity` (dof,)."""
        limits = self.limits
        change = limits.acceleration * TICK * np.arange(1, 1 + round(self.period / TICK))[:, None]
        return np.clip(
            np.clip(velocity, -limits.velocity, limits.velocity), self._drives - change, self._drives + change
        )
