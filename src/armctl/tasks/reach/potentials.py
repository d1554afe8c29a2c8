"""Potentials of reach tasks: what experts know about a state, for reward shaping."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.control.reach_mpc import ReachMpc
from armctl.kinematics import ArmModel, ReachabilityMap, ReachTimes, ReachTimesOptions
from armctl.tasks.task import Ids, Potential

Array = NDArray[np.float64]

QUICK = ReachTimesOptions(nearby=64, goals=8, iterations=1)
"""For targets that move, and are looked up at every control step."""
WAYPOINTS = 64
"""On the path around obstacles."""
DETOUR = 4.0
"""Times as long as a second on the path counts a second beside it."""


class MinimumTime(Potential):
    """Minus the least time until the end-effector can be in the target's sphere, over all IK solutions, s.

    It is that of `ReachTimes`: for a UR5, 0.01 s above `MinimumTimeReach` in the median, 0.05 s in nine cases of ten.
    """

    effort = ReachTimesOptions()

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        self._times = ReachTimes(ArmModel(task.arm.description), task.options.tolerance, self.effort)
        self._spheres = self._times.spheres(task.state.target_position)

    def begin(self, ids: Ids) -> None:
        """Look up configurations in the targets' spheres."""
        self._spheres.put(ids, self._times.spheres(self.task.state.target_position[ids]))

    def potentials(self, ids: Ids) -> Array:
        """In s, (len(ids),)."""
        state = self.task.state
        moved = ids[(self._spheres.centres[ids] != state.target_position[ids]).any(axis=1)]
        if len(moved):
            self.begin(moved)
        return -self._times.least(state.joint_positions[ids], state.joint_velocities[ids], self._spheres.only(ids))


class MinimumTimeToMovingTarget(MinimumTime):
    """The same, with less effort, for a target that is looked up at every control step."""

    effort = QUICK


class MpcCost(Potential):
    """Minus the cost of the MPC's plan for the next 0.8 s, m^2, planned from scratch: slow, for a few worlds."""

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        model = ArmModel(task.arm.description)
        self._map, self._mpc = ReachabilityMap(model), ReachMpc(model)
        self._chosen = np.tile(model.home, (len(task.state.distance), 1))

    def begin(self, ids: Ids) -> None:
        """Look up configurations with the end-effector at the targets."""
        state = self.task.state
        for i in ids:
            at, target = state.joint_positions[i], state.target_position[i]
            self._chosen[i] = self._map.towards(target, at, self._mpc.model)

    def potentials(self, ids: Ids) -> Array:
        """In m^2, (len(ids),)."""
        return np.array([-self._cost(i) for i in ids])

    def _cost(self, world: int) -> float:
        state = self.task.state
        self._mpc.reset()
        plan = self._mpc.plan(
            state.joint_positions[world],
            state.joint_velocities[world],
            state.target_position[world],
            self._chosen[world],
        )
        return plan.cost


class PathCostToGo(Potential):
    """Minus the time along the path that the planner found around the obstacles, s, at the joints' velocity limits.

    Off the path, it is the time from the best waypoint, and `DETOUR` times the time to get there: with less, shortcuts
    through obstacles would look short. 0 where no path was found.
    """

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        self._model = ArmModel(task.arm.description)
        n = len(task.state.distance)
        self._points, self._to_go = np.zeros((n, WAYPOINTS, self._model.dof)), np.zeros((n, WAYPOINTS))
        self._known = np.zeros((n, 1))

    def begin(self, ids: Ids) -> None:
        """Spread waypoints evenly over the paths."""
        for i in ids:
            path = self.task.path(int(i))
            self._known[i] = len(path) > 0
            if len(path):
                self._points[i], self._to_go[i] = self._spread(path)

    def potentials(self, ids: Ids) -> Array:
        """In s, (len(ids),)."""
        q = self.task.state.joint_positions[ids]
        beside = self._model.cruise_time(q[:, None], self._points[ids])
        to_go = self._known[ids] * (DETOUR * beside + self._to_go[ids])
        return -np.asarray(to_go.min(axis=1))

    def _spread(self, path: Array) -> tuple[Array, Array]:
        """Points (`WAYPOINTS`, dof) on a path (m, dof), and the remaining time from each, s."""
        times = np.concatenate(([0.0], np.cumsum(self._model.cruise_time(path[:-1], path[1:]))))
        at = np.linspace(0.0, times[-1], WAYPOINTS)
        return np.column_stack([np.interp(at, times, joint) for joint in path.T]), times[-1] - at
