"""The state of n push worlds at a control step, and the observations and rewards that are functions of it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.tasks.reach.observation import FEATURES, HIDDEN, LENGTH_SCALE, OBSERVATION, rotated
from armctl.tasks.reach.state import REWARD, STEP_REWARD, ReachState, Term
from armctl.tasks.task import OneTimeTerm

FELL_REWARD = 300 * STEP_REWARD
"""Price of an object that falls: that of the 300 control steps of an episode, so that it never pays."""


@dataclass(frozen=True)
class PushState(ReachState):
    """The state of arm and object. `distance` is that of the object's centre from the target, in the table's plane."""

    tool_position: Array
    """(n, 3) m: where the tool ends."""
    object_position: Array
    """(n, 3) m."""
    object_axis: Array
    """(n, 2) cosine and sine of the object's yaw."""
    object_velocity: Array
    """(n, 3) x, y, m/s, and yaw, rad/s."""
    fell: NDArray[np.bool_]
    """(n,) whether the object has left the table, or lies on another side."""


PUSH_OBSERVATION: Mapping[str, Term] = {
    "tool_position": lambda state: state.tool_position,
    "joint_positions": OBSERVATION["joint_positions"],
    "target_position": OBSERVATION["target_position"],
    "object_position": lambda state: state.object_position,
    "object_axis": lambda state: state.object_axis,
    "object_velocity": lambda state: state.object_velocity,
}


def _ahead(vectors: Array, state: PushState) -> Array:
    return LENGTH_SCALE * rotated(vectors, -state.base_yaw)


def _level(vectors: Array, state: PushState) -> Array:
    """Return vectors of the table's plane, (n, 2 or 3), in the frame that turns with the base."""
    turned = rotated(np.column_stack((vectors[:, :2], np.zeros(len(vectors)))), -state.base_yaw)
    return np.column_stack((turned[:, :2], vectors[:, 2:]))


PUSH_FEATURES: Mapping[str, Term] = {
    "tool_ahead": lambda state: _ahead(state.tool_position, state),
    "object_ahead": lambda state: _ahead(state.object_position, state),
    "target_ahead": FEATURES["target_ahead"],
    "tool_to_object": lambda state: _ahead(state.object_position - state.tool_position, state),
    "object_to_target": lambda state: _ahead(state.target_position - state.object_position, state),
    "object_axis_ahead": lambda state: _level(state.object_axis, state),
    "object_velocity_ahead": lambda state: _level(state.object_velocity, state),
    "sines": FEATURES["sines"],
    "cosines": FEATURES["cosines"],
}
PUSH_OBSERVATIONS: Mapping[str, Mapping[str, Term]] = {
    "paper": PUSH_OBSERVATION,
    "features": PUSH_FEATURES,
    "full": {**PUSH_OBSERVATION, **HIDDEN},
}
"""The parts of each named observation, in order."""

PUSH_REWARD: Mapping[str, Term] = {
    **REWARD,
    "fell": OneTimeTerm(lambda state: np.where(state.fell, FELL_REWARD, 0.0), (FELL_REWARD, 0.0)),
}
"""The terms of the reward, whose sum is the reward."""
