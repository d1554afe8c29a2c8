"""Potentials of reach tasks for reward shaping, from experts, which are imported when one is made."""

from typing import Any

import numpy as np

from armctl import control, planning
from armctl.core.arrays import Array
from armctl.kinematics import ArmModel, MinimumTimePose, ReachabilityMap, ReachTimes, ReachTimesOptions, Spheres
from armctl.kinematics.minimum_time_pose import BRANCHES
from armctl.tasks.task import Ids, Potential

QUICK = ReachTimesOptions(nearby=64, goals=8, iterations=1)
"""Options for moving targets, which are looked up at every control step."""
WAYPOINTS = 64
"""Number of points on the path around obstacles."""
DETOUR = 4.0
"""Weight of the time to get to the path, relative to the time along it."""


class MinimumTime(Potential):
    """Minus the least time in which the end-effector can reach the target's sphere, over all IK solutions, s.

    It is computed by `ReachTimes`. For a UR5 it exceeds that of `MinimumTimeReach` by 0.01 s in the median, and by
    0.05 s at the 90th percentile.
    """

    effort = ReachTimesOptions()

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        self._times = ReachTimes(ArmModel(task.arm.description), task.options.tolerance, self.effort)
        self._spheres = self._times.spheres(task.state.target_position)

    def begin(self, ids: Ids) -> None:
        """Look up configurations with the end-effector in the targets' spheres."""
        for values, new in zip(self._spheres, self._times.spheres(self.task.state.target_position[ids]), strict=True):
            values[ids] = new

    def potentials(self, ids: Ids) -> Array:
        """Return (len(ids),) s."""
        state = self.task.state
        moved = ids[(self._spheres.centres[ids] != state.target_position[ids]).any(axis=1)]
        if len(moved):
            self.begin(moved)
        spheres = Spheres(*(values[ids] for values in self._spheres))
        return -self._times.min_times(state.joint_positions[ids], state.joint_velocities[ids], spheres)


class MinimumTimeToMovingTarget(MinimumTime):
    """The same with less effort, since a moving target is looked up at every control step."""

    effort = QUICK


class MinimumTimeToPose(Potential):
    """Minus the least time in which the end-effector can reach the target's pose, over all IK branches, s.

    Branches in collision are left out. The tolerance is that of `MinimumTimePose`, within the task's.
    """

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        self._search = MinimumTimePose(ArmModel(task.arm.description), task.lever)
        n, dof = task.state.joint_positions.shape
        self._goals, self._centres = np.full((n, BRANCHES + 1, dof), np.nan), np.zeros((n, 12))

    def begin(self, ids: Ids) -> None:
        """Compute the configurations in the targets' poses."""
        state, home = self.task.state, self._search.model.home
        self._centres[ids] = self._search.centre(state.target_position[ids], state.target_axes[ids])
        for i in ids:
            branches = self._search.at_centre(home, self._centres[i])
            self._goals[i] = np.nan
            self._goals[i, : len(branches) + 1] = (self.task.certificates[i], *branches)

    def potentials(self, ids: Ids) -> Array:
        """Return (len(ids),) s."""
        state, radius = self.task.state, self.task.options.tolerance
        centres, goals = self._centres[ids], self._goals[ids]
        return -self._search.times(state.joint_positions[ids], state.joint_velocities[ids], centres, radius, goals)


class MpcCost(Potential):
    """Minus the cost of the MPC's plan for the next 0.8 s, m^2. It is planned from scratch: slow, for a few worlds."""

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        model = ArmModel(task.arm.description)
        self._map, self._mpc = ReachabilityMap(model), control.ReachMpc(model)
        self._chosen = np.tile(model.home, (len(task.state.distance), 1))

    def begin(self, ids: Ids) -> None:
        """Look up configurations with the end-effector at the targets."""
        state = self.task.state
        for i in ids:
            at, target = state.joint_positions[i], state.target_position[i]
            self._chosen[i] = self._map.towards(target, at, self._mpc.model)

    def potentials(self, ids: Ids) -> Array:
        """Return (len(ids),) m^2."""
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
    """Minus the time to go along `ArmPlanner`'s path around the obstacles, s, at the joints' velocity limits.

    Off the path, it is the time from the best waypoint plus `DETOUR` times the time to that waypoint. With a smaller
    weight, shortcuts through obstacles would look short. 0 if no path was found.
    """

    def __init__(self, task: Any) -> None:
        super().__init__(task)
        self._model = ArmModel(task.arm.description)
        self._planner = planning.ArmPlanner(self._model)
        n = len(task.state.distance)
        self._points, self._to_go = np.zeros((n, WAYPOINTS, self._model.dof)), np.zeros((n, WAYPOINTS))
        self._has_path = np.zeros((n, 1))

    def begin(self, ids: Ids) -> None:
        """Plan from home, and distribute waypoints evenly over the paths."""
        targets, tolerance = self.task.state.target_position, self.task.options.tolerance
        home = self._model.home.astype(np.float32).astype(float)  # as observed: then it is the path of `reach_ompl`
        for i in ids:
            path = self._planner.plan(home, targets[i], tolerance, self.task.boxes(int(i))).path
            self._has_path[i] = len(path) > 0
            if len(path):
                self._points[i], self._to_go[i] = self._waypoints(path)

    def potentials(self, ids: Ids) -> Array:
        """Return (len(ids),) s."""
        q = self.task.state.joint_positions[ids]
        to_path = self._model.cruise_time(q[:, None], self._points[ids])
        to_go = self._has_path[ids] * (DETOUR * to_path + self._to_go[ids])
        return -np.asarray(to_go.min(axis=1))

    def _waypoints(self, path: Array) -> tuple[Array, Array]:
        """Return points (`WAYPOINTS`, dof) on a path (m, dof), and the remaining time from each, s."""
        times = np.concatenate(([0.0], np.cumsum(self._model.cruise_time(path[:-1], path[1:]))))
        at = np.linspace(0.0, times[-1], WAYPOINTS)
        return np.column_stack([np.interp(at, times, joint) for joint in path.T]), times[-1] - at
