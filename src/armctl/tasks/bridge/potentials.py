"""Potentials of bridge tasks: what planners know about a state, for reward shaping."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from armctl.planning import Lattice
from armctl.scene import BridgeMap
from armctl.tasks.bridge.state import BridgeState

Array = NDArray[np.float64]
Ids = NDArray[np.int32]

CLEARANCE = 0.36
"""m around the blocks: somewhat less than the planner keeps, for gaps that are just wide enough for it."""


class BridgeWorlds(Protocol):
    """What potentials need of a bridge task."""

    goal_x: float

    @property
    def state(self) -> BridgeState:
        """The present state."""

    def map(self, world: int) -> BridgeMap:
        """What is on the bridge of a world."""


class DistanceToGoalLine:
    """Minus the distance straight to the goal line, m: the naive one, for comparison."""

    def __init__(self, task: BridgeWorlds) -> None:
        self._task = task

    def begin(self, ids: Ids) -> None:
        """Nothing to prepare."""

    def potentials(self, ids: Ids) -> Array:
        """In m, (len(ids),)."""
        return -np.maximum(self._task.state.distance[ids], 0.0)


class CrossingCostToGo:
    """Minus the length of the shortest path to the goal line around the blocks, m."""

    def __init__(self, task: BridgeWorlds) -> None:
        self._task = task
        bridge = task.map(0)
        self._lattice = Lattice(bridge.length, bridge.half_width)
        self._lengths = np.zeros((len(task.state.poses), *self._lattice.shape))

    def begin(self, ids: Ids) -> None:
        """Compute the lengths from all points of the bridges."""
        for i in ids:
            self._lengths[i] = self._lattice.lengths(self._task.map(int(i)), self._task.goal_x, CLEARANCE)

    def potentials(self, ids: Ids) -> Array:
        """In m, (len(ids),)."""
        return -self._lattice.interpolate(self._lengths[ids], self._task.state.poses[ids, :2])
