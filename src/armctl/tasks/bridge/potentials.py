"""Potentials of bridge tasks for reward shaping, from planners, which are imported when one is made."""

from typing import Any

import numpy as np

from armctl import planning
from armctl.core.arrays import Array
from armctl.tasks.task import Ids, Potential

CLEARANCE = 0.36
"""m around the blocks: somewhat less than the planner keeps, so that gaps just wide enough for it stay open."""


class CrossingCostToGo(Potential):
    """Minus the length of the shortest path to the goal line around the blocks, m."""

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        bridge = task.map(0)
        self._lattice = planning.Lattice(bridge.length, bridge.half_width)
        self._lengths = np.zeros((len(task.state.poses), *self._lattice.shape))

    def begin(self, ids: Ids) -> None:
        """Compute the path lengths from all points of the bridges of worlds `ids`."""
        for i in ids:
            self._lengths[i] = self._lattice.lengths(self.task.map(int(i)), self.task.goal_x, CLEARANCE)

    def potentials(self, ids: Ids) -> Array:
        """Return (len(ids),) m."""
        return -self._lattice.interpolate(self._lengths, self.task.state.poses[ids, :2], tables=(ids,))


class CrossingTimeToGo(Potential):
    """Minus the least time to the goal line, s, past the people as they will walk.

    It is a function of the rover's place and of the time since the episode began, which stand for where the people are.
    So it leaves the best policies as they are among those that know the time, or see it by the people (Devlin and
    Kudenko, "Dynamic potential-based reward shaping", AAMAS 2012, for potentials of state and time). It is computed at
    the episode's beginning, for 30 s.
    """

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        bridge, num_envs = task.map(0), len(task.state.poses)
        self._space_time = planning.SpaceTime(planning.Lattice(bridge.length, bridge.half_width))
        self._unhindered = np.zeros((num_envs, *self._space_time.lattice.shape))
        self._extra = np.zeros((num_envs, *self._space_time.shape), dtype=np.float32)

    def begin(self, ids: Ids) -> None:
        """Compute the times from all points at all times of the bridges of worlds `ids`."""
        for i in ids:
            times = self._space_time.times(self.task.map(int(i)), self.task.goal_x, CLEARANCE)
            self._unhindered[i], self._extra[i] = times.unhindered, times.extra

    def potentials(self, ids: Ids) -> Array:
        """Return (len(ids),) s."""
        state = self.task.state
        points, times = state.poses[ids, :2], state.time[ids]
        return -self._space_time.interpolate(self._unhindered, self._extra, ids, points, times)
