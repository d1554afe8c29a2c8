"""The state of n lift worlds at a control step, and the observations that are functions of it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.tasks.reach.observation import FEATURES, HIDDEN, LENGTH_SCALE, OBSERVATION
from armctl.tasks.reach.pose import END_EFFECTOR_AXES, POSE_FEATURES
from armctl.tasks.reach.state import Term
from armctl.tasks.tabletop.state import OBJECT_FEATURES, OBJECT_OBSERVATION, TabletopState, ahead

OPENING_SCALE = 10.0
"""1/m: scales the hand's opening to the order of one."""


@dataclass(frozen=True)
class LiftState(TabletopState):
    """The state of arm, hand and object. `distance` is that of the object's centre from the target's height."""

    end_effector_axes: Array
    """(n, 6): the first two axes of its frame."""
    finger_opening: Array
    """(n, 1) m between the fingers' pads."""
    grasped: NDArray[np.bool_]
    """(n,) whether both fingers touch the object."""


LIFT_OBSERVATION: Mapping[str, Term] = {
    "end_effector_position": OBSERVATION["end_effector_position"],
    "joint_positions": OBSERVATION["joint_positions"],
    "finger_opening": lambda state: state.finger_opening,
    "end_effector_axes": END_EFFECTOR_AXES,
    "target_height": lambda state: state.target_position[:, 2:],
    **OBJECT_OBSERVATION,
}


def _faces(state: LiftState) -> Array:
    """Return cosine and sine of four times the object's yaw in the hand: equal for all of a box's sides."""
    fingers = np.arctan2(state.end_effector_axes[:, 4], state.end_effector_axes[:, 3])
    turns = 4 * (np.arctan2(state.object_axis[:, 1], state.object_axis[:, 0]) - fingers)
    return np.column_stack((np.cos(turns), np.sin(turns)))


LIFT_FEATURES: Mapping[str, Term] = {
    "end_effector_ahead": FEATURES["end_effector_ahead"],
    "end_effector_axes_ahead": POSE_FEATURES["end_effector_axes_ahead"],
    "finger_opening_scaled": lambda state: OPENING_SCALE * state.finger_opening,
    "height_to_go": lambda state: LENGTH_SCALE * (state.target_position - state.object_position)[:, 2:],
    "object_ahead": OBJECT_FEATURES["object_ahead"],
    "hand_to_object": lambda state: ahead(state.object_position - state.end_effector_position, state),
    "faces": _faces,
    "object_velocity_ahead": OBJECT_FEATURES["object_velocity_ahead"],
    "sines": FEATURES["sines"],
    "cosines": FEATURES["cosines"],
}
LIFT_OBSERVATIONS: Mapping[str, Mapping[str, Term]] = {
    "paper": LIFT_OBSERVATION,
    "features": LIFT_FEATURES,
    "full": {**LIFT_OBSERVATION, **HIDDEN},
}
"""The parts of each named observation, in order."""
