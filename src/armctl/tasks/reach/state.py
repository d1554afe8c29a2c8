"""The state of n reach worlds at a control step. Observation, reward and potentials are functions of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.tasks.task import EachStep, OneTimeTerm


@dataclass(frozen=True)
class ReachState:
    """Everything that reward terms and observation parts may use, for n worlds; in rad, rad/s and m."""

    end_effector_position: Array
    """(n, 3)"""
    joint_positions: Array
    """(n, dof)"""
    joint_velocities: Array
    """(n, dof)"""
    target_position: Array
    """(n, 3)"""
    distance: Array
    """(n,) from the end-effector to the target's centre."""
    previous_distance: Array
    """(n,) the distance one control step earlier."""
    reached: NDArray[np.bool_]
    """(n,) whether the end-effector has been within the tolerance of the target since the last control step."""
    target_velocity: Array
    """(n, 3) m/s."""
    action: Array
    """(n, dof) the policy's last action, before clipping."""
    drive_commands: tuple[Array, Array]
    """(n, dof) positions and velocities that the drives are commanded now; (n, 0) if they are given torques."""
    base_turns: bool
    """True if the first joint's axis is vertical."""

    @property
    def commands(self) -> Array:
        """(n, 2 dof) `drive_commands` side by side."""
        return np.concatenate(self.drive_commands, axis=1)

    @property
    def base_yaw(self) -> Array:
        """(n,) angle of the first joint, if its axis is vertical; otherwise 0."""
        return self.joint_positions[:, 0] if self.base_turns else np.zeros(len(self.reached))

    @property
    def posture(self) -> Array:
        """(n, k) joint positions, without the first joint's if its axis is vertical."""
        return self.joint_positions[:, 1:] if self.base_turns else self.joint_positions


Term = Callable[[Any], NDArray[np.floating[Any]]]
"""A function of the state of n worlds."""

STEP_REWARD, GOAL_REWARD = -1.0, 100.0
"""Rewards for each control step, and for success."""

REWARD: Mapping[str, Term] = {
    "step": EachStep(lambda state: np.full(len(state.reached), STEP_REWARD), (STEP_REWARD, STEP_REWARD)),
    "goal": OneTimeTerm(lambda state: GOAL_REWARD * state.reached, (0.0, GOAL_REWARD)),
}
"""The terms of the reward, whose sum is the reward."""
