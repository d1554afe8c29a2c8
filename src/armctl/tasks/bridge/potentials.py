"""Potentials of bridge tasks for reward shaping, from planners."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.planning import Lattice
from armctl.tasks.task import Ids, Potential

Array = NDArray[np.float64]

CLEARANCE = 0.36
"""m around the blocks: somewhat less than the planner keeps, so that gaps just wide enough for it stay open."""


class CrossingCostToGo(Potential):
    """Minus the length of the shortest path to the goal line around the blocks, m."""

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        bridge = task.map(0)
        self._lattice = Lattice(bridge.length, bridge.half_width)
        self._lengths = np.zeros((len(task.state.poses), *self._lattice.shape))

    def begin(self, ids: Ids) -> None:
        """Compute the path lengths from all points of the bridges of worlds `ids`."""
        for i in ids:
            self._lengths[i] = self._lattice.lengths(self.task.map(int(i)), self.task.goal_x, CLEARANCE)

    def potentials(self, ids: Ids) -> Array:
        """(len(ids),) m."""
        return -self._lattice.interpolate(self._lengths[ids], self.task.state.poses[ids, :2])
