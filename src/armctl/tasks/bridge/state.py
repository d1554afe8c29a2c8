"""The state of n bridge worlds at a control step. Reward and potentials are functions of it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.tasks.task import EachStep, OneTimeTerm


@dataclass(frozen=True, eq=False)
class BridgeState:
    """Everything that reward terms may use. Every array has a leading axis n, the number of worlds."""

    time: Array
    """Time since the episode began, s, (n,)."""
    poses: Array
    """True x, y (m) and yaw (rad) of the rover, (n, 3)."""
    velocities: Array
    """True forward velocity (m/s) and yaw rate (rad/s), (n, 2)."""
    distance: Array
    """Distance to the goal line, m, (n,)."""
    previous_distance: Array
    """The distance one control step ago, m, (n,); after a reset, `distance`."""
    contacts: NDArray[np.bool_]
    """Contacts of each part since the last control step, (n, `PARTS`, `CONTACT_CLASSES`)."""
    crossed: NDArray[np.bool_]
    """A part has touched the goal line, and no part has touched anything forbidden, (n,)."""
    collided: NDArray[np.bool_]
    """A part has touched a barrier or an obstacle, or the base the floor, (n,)."""
    fell: NDArray[np.bool_]
    """A wheel has dropped off the deck, or the rover is beside it or leans over by more than 60 degrees, (n,)."""
    action: Array
    """Linear and angular velocity commanded last, before clipping, (n, 2); zeros after a reset."""


Term = Callable[[BridgeState], NDArray[np.floating[Any]]]

REWARD: dict[str, Term] = {
    "time": EachStep(lambda state: np.full(len(state.crossed), -0.1), (-0.1, -0.1)),
    "goal": OneTimeTerm(lambda state: np.where(state.crossed, 100.0, 0.0), (0.0, 100.0)),
    "collision": OneTimeTerm(lambda state: np.where(state.collided, -100.0, 0.0), (-100.0, 0.0)),
    "fall": OneTimeTerm(lambda state: np.where(state.fell, -100.0, 0.0), (-100.0, 0.0)),
}
"""Named reward terms, (n,) each; the reward is their sum."""
