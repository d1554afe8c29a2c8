"""The IK expert: among the arm's ways to touch the target sphere, take the one that the joints can reach soonest.

It plans once an episode, on Pinocchio's kinematics and from the observation alone, and then holds its course. Should
the arm stand still elsewhere, it plans again from there. A target that moves it follows by plain IK, step by step.
"""

import numpy as np
from numpy.typing import NDArray

from armctl.envs import TaskVectorEnv
from armctl.errors import ConfigurationError
from armctl.kinematics import ArmModel, MinimumTimeReach
from armctl.policies import PerWorld
from armctl.robot_description.joint_profiles import towards
from armctl.tasks import OBSERVATION, ReachMovingTask, ReachTask

Array = NDArray[np.float64]

MARGIN = 0.9
"""Part of the tolerance that is aimed at, for the servos' sake."""
STANDSTILL = 1e-3
"""rad between two decisions, below which the arm stands still."""
PATIENCE = 5
"""Decisions at a standstill after which it plans anew."""


def make(env: TaskVectorEnv) -> PerWorld:
    """Pinocchio IK: of the ways to touch the target without a collision, the one that the joints reach soonest."""
    if not isinstance(env.task, ReachTask):
        raise ConfigurationError("reach_ik moves arms: use it with armctl/ArmReach-v0")
    options, arm = env.task.options, env.task.arm
    if list(options.observation)[: len(OBSERVATION)] != list(OBSERVATION):
        raise ConfigurationError(f"reach_ik reads the observation {', '.join(OBSERVATION)}; here it is another")
    touch = MinimumTimeReach(ArmModel(arm.description))
    make_one = Follow if isinstance(env.task, ReachMovingTask) else ReachIk
    return PerWorld([make_one(touch, options.tolerance, options.control, arm.period) for _ in range(env.num_envs)])


class ReachIk:
    """Reaches with one arm. Raises `ConfigurationError` for torque control, which IK has no say in."""

    def __init__(self, touch: MinimumTimeReach, tolerance: float, control: str, period: float) -> None:
        if control == "torque":
            raise ConfigurationError("reach_ik commands joint motions: use control 'position', 'delta' or 'velocity'")
        self._touch, self._tolerance, self._control, self._period = touch, tolerance, control, period
        self.reset()

    def reset(self) -> None:
        """Forget the plan."""
        self._goal: Array | None = None
        self._last: Array | None = None
        self._still = 0

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Action (dof,) for an observation: end-effector position, joint positions, target position, and what not."""
        dof = self._touch.model.dof
        q, target = observation[3 : 3 + dof].astype(float), observation[3 + dof : 6 + dof].astype(float)
        return self._towards(self._next_goal(q, target), q)

    def _next_goal(self, q: Array, target: Array) -> Array:
        moved = self._last is None or np.abs(q - self._last).max() > STANDSTILL
        self._still = 0 if moved else self._still + 1
        if self._goal is None or self._still == PATIENCE:
            self._goal, self._still = self._plan(q, target), 0
        self._last = q
        return self._goal

    def _plan(self, q: Array, target: Array) -> Array:
        touch = self._touch.find(q, target, MARGIN * self._tolerance)
        return self._touch.ik.position(target, q).closest if touch is None else touch.command

    def _towards(self, goal: Array, q: Array) -> Array:
        velocity = towards(goal, q, self._touch.model.limits, self._period)
        return {"position": goal, "delta": velocity * self._period, "velocity": velocity}[self._control]


class Follow(ReachIk):
    """Follows a target that moves: the solution for where it is now, nearest to the last one."""

    def _next_goal(self, q: Array, target: Array) -> Array:
        seed = self._plan(q, target) if self._goal is None else self._goal
        self._goal = self._touch.ik.position(target, seed).closest
        return self._goal
