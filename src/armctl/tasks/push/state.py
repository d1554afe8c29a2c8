"""The state of n push worlds at a control step, and the observations that are functions of it."""

from collections.abc import Mapping
from dataclasses import dataclass

from armctl.core.arrays import Array
from armctl.tasks.reach.observation import FEATURES, HIDDEN, OBSERVATION
from armctl.tasks.reach.state import Term
from armctl.tasks.tabletop.state import OBJECT_FEATURES, OBJECT_OBSERVATION, TabletopState, ahead


@dataclass(frozen=True)
class PushState(TabletopState):
    """The state of arm and object. `distance` is that of the object's centre from the target, in the table's plane."""

    tool_position: Array
    """(n, 3) m: where the tool ends."""


PUSH_OBSERVATION: Mapping[str, Term] = {
    "tool_position": lambda state: state.tool_position,
    "joint_positions": OBSERVATION["joint_positions"],
    "target_position": OBSERVATION["target_position"],
    **OBJECT_OBSERVATION,
}
PUSH_FEATURES: Mapping[str, Term] = {
    "tool_ahead": lambda state: ahead(state.tool_position, state),
    "object_ahead": OBJECT_FEATURES["object_ahead"],
    "target_ahead": FEATURES["target_ahead"],
    "tool_to_object": lambda state: ahead(state.object_position - state.tool_position, state),
    "object_to_target": lambda state: ahead(state.target_position - state.object_position, state),
    "object_axis_ahead": OBJECT_FEATURES["object_axis_ahead"],
    "object_velocity_ahead": OBJECT_FEATURES["object_velocity_ahead"],
    "sines": FEATURES["sines"],
    "cosines": FEATURES["cosines"],
}
PUSH_OBSERVATIONS: Mapping[str, Mapping[str, Term]] = {
    "paper": PUSH_OBSERVATION,
    "features": PUSH_FEATURES,
    "full": {**PUSH_OBSERVATION, **HIDDEN},
}
"""The parts of each named observation, in order."""
