"""What is known of n reach worlds at a control step: observation, reward and potentials are functions of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ReachState:
    """All that reward and observation terms may use, for n worlds; rad, rad/s, m."""

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
    """(n,) the same, one control step earlier."""
    reached: NDArray[np.bool_]
    """(n,) whether the end-effector has been within the tolerance of the target since the last control step."""
    target_velocity: Array
    """(n, 3) m/s."""
    action: Array
    """(n, dof) the last action, as the policy gave it."""


Term = Callable[[Any], NDArray[np.floating[Any]]]
"""A function of the state of n worlds."""

OBSERVATION: Mapping[str, Term] = {
    "end_effector_position": lambda state: state.end_effector_position,
    "joint_positions": lambda state: state.joint_positions,
    "target_position": lambda state: state.target_position,
}
"""The parts of an observation, in order."""

REWARD: Mapping[str, Term] = {
    "step": lambda state: np.full(len(state.reached), -1.0),
    "goal": lambda state: 100.0 * state.reached,
}
"""The terms of the reward, whose sum is the reward."""
