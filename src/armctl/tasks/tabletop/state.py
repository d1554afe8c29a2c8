"""The state of n worlds with an object on a table, and the observations and rewards that are functions of it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.tasks.reach.observation import LENGTH_SCALE, rotated
from armctl.tasks.reach.state import REWARD, STEP_REWARD, ReachState, Term
from armctl.tasks.task import OneTimeTerm

FELL_REWARD = 300 * STEP_REWARD
"""Price of an object that falls: that of the 300 control steps of an episode, so that it never pays."""


@dataclass(frozen=True)
class TabletopState(ReachState):
    """The state of arm and object."""

    object_position: Array
    """(n, 3) m."""
    object_axis: Array
    """(n, 2) cosine and sine of the object's yaw."""
    object_velocity: Array
    """(n, 3) x, y, m/s, and yaw, rad/s."""
    at_rest: NDArray[np.bool_]
    """(n,) whether the object hardly moves."""
    fell: NDArray[np.bool_]
    """(n,) whether the object has left the table, or lies on another side."""


OBJECT_OBSERVATION: Mapping[str, Term] = {
    "object_position": lambda state: state.object_position,
    "object_axis": lambda state: state.object_axis,
    "object_velocity": lambda state: state.object_velocity,
}


def ahead(vectors: Array, state: ReachState) -> Array:
    """Return vectors (n, 3) in the frame that turns with the base, scaled to the order of one."""
    return LENGTH_SCALE * rotated(vectors, -state.base_yaw)


def level(vectors: Array, state: ReachState) -> Array:
    """Return vectors of the table's plane, (n, 2 or 3), in the frame that turns with the base."""
    turned = rotated(np.column_stack((vectors[:, :2], np.zeros(len(vectors)))), -state.base_yaw)
    return np.column_stack((turned[:, :2], vectors[:, 2:]))


OBJECT_FEATURES: Mapping[str, Term] = {
    "object_ahead": lambda state: ahead(state.object_position, state),
    "object_axis_ahead": lambda state: level(state.object_axis, state),
    "object_velocity_ahead": lambda state: level(state.object_velocity, state),
}

TABLETOP_REWARD: Mapping[str, Term] = {
    **REWARD,
    "fell": OneTimeTerm(lambda state: np.where(state.fell, FELL_REWARD, 0.0), (FELL_REWARD, 0.0)),
}
"""The terms of the reward, whose sum is the reward."""
