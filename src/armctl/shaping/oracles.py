"""What experts know of a state, as potentials: the higher, the nearer to the goal.

A potential is a function of the state alone, and stays the same one for an episode.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armctl.control.reach_mpc import ReachMpc
from armctl.envs import TaskVectorEnv
from armctl.errors import unknown_name
from armctl.kinematics import ArmModel, LookUp, Postures, ReachTimes
from armctl.planning import Lattice
from armctl.tasks import BridgeTask, ReachMovingTask, ReachObstaclesTask, ReachTask

Array = NDArray[np.float64]
Ids = NDArray[np.int32]

QUICK = LookUp(nearby=64, goals=8, iterations=1)
"""For spheres that move, and are looked up at every decision."""
WAY_POINTS = 64
"""On the way around obstacles."""
DETOUR = 4.0
"""Times as long as a s on the way counts a s beside it."""
CLEARANCE = 0.36
"""m around the blocks on a bridge: somewhat less than the planner keeps, for gaps that are just wide enough for it."""


class Oracle(Protocol):
    """Potentials of n worlds."""

    def begin(self, ids: Ids) -> None:
        """Worlds `ids` have begun a new episode."""

    def potentials(self, ids: Ids) -> Array:
        """Potentials of worlds `ids` as they are now, (len(ids),)."""


OracleFactory = Callable[[TaskVectorEnv], Oracle]


class ReachDistance:
    """Minus the distance from the end-effector to the target, m: the naive one, for comparison."""

    def __init__(self, task: ReachTask) -> None:
        self._task = task

    def begin(self, ids: Ids) -> None:
        """Nothing to prepare."""

    def potentials(self, ids: Ids) -> Array:
        """In m, (len(ids),)."""
        return -self._task.state.distance[ids]


class LeastTime:
    """Minus the least time until the end-effector can be in the target's sphere, over all IK solutions, s.

    It is that of `ReachTimes`: for a UR5, 0.01 s above what `SoonestTouch` finds in the median, 0.05 in nine of ten.
    """

    def __init__(self, task: ReachTask) -> None:
        self._task = task
        effort = QUICK if isinstance(task, ReachMovingTask) else LookUp()
        self._times = ReachTimes(ArmModel(task.arm.description), task.options.tolerance, effort)
        self._spheres = self._times.spheres(task.state.target_position)

    def begin(self, ids: Ids) -> None:
        """Look up configurations in the targets' spheres."""
        self._spheres.put(ids, self._times.spheres(self._task.state.target_position[ids]))

    def potentials(self, ids: Ids) -> Array:
        """In s, (len(ids),)."""
        state = self._task.state
        moved = ids[(self._spheres.centres[ids] != state.target_position[ids]).any(axis=1)]
        if len(moved):
            self.begin(moved)
        return -self._times.least(state.joint_positions[ids], state.joint_velocities[ids], self._spheres.only(ids))


class MpcCost:
    """Minus the cost of the MPC's plan for the next 0.8 s, m^2, planned from nothing: slow, for a few worlds."""

    def __init__(self, task: ReachTask) -> None:
        self._task = task
        model = ArmModel(task.arm.description)
        self._postures, self._mpc = Postures(model), ReachMpc(model)
        self._chosen = np.tile(model.home, (len(task.state.distance), 1))

    def begin(self, ids: Ids) -> None:
        """Look up postures with the end-effector at the targets."""
        state = self._task.state
        for i in ids:
            at, target = state.joint_positions[i], state.target_position[i]
            self._chosen[i] = self._postures.towards(target, at, self._mpc.model)

    def potentials(self, ids: Ids) -> Array:
        """In m^2, (len(ids),)."""
        return np.array([-self._cost(i) for i in ids])

    def _cost(self, world: int) -> float:
        state = self._task.state
        self._mpc.reset()
        plan = self._mpc.plan(
            state.joint_positions[world],
            state.joint_velocities[world],
            state.target_position[world],
            self._chosen[world],
        )
        return plan.cost


class WayToGo:
    """Minus the time along the way that the planner has found around the obstacles, s, at the joints' velocity limits.

    Beside the way, it is that from the best of its points, and `DETOUR` times the time to go there: with less, ways
    through obstacles would look short. 0 where no way was found.
    """

    def __init__(self, task: ReachObstaclesTask) -> None:
        self._task, self._model = task, ArmModel(task.arm.description)
        n = len(task.state.distance)
        self._points, self._to_go = np.zeros((n, WAY_POINTS, self._model.dof)), np.zeros((n, WAY_POINTS))
        self._known = np.zeros((n, 1))

    def begin(self, ids: Ids) -> None:
        """Spread points evenly over the ways."""
        for i in ids:
            way = self._task.way(int(i))
            self._known[i] = len(way) > 0
            if len(way):
                self._points[i], self._to_go[i] = self._spread(way)

    def potentials(self, ids: Ids) -> Array:
        """In s, (len(ids),)."""
        q = self._task.state.joint_positions[ids]
        beside = self._model.cruise_time(q[:, None], self._points[ids])
        to_go = self._known[ids] * (DETOUR * beside + self._to_go[ids])
        return -np.asarray(to_go.min(axis=1))

    def _spread(self, way: Array) -> tuple[Array, Array]:
        """Points (`WAY_POINTS`, dof) on a way (m, dof), and the time to go from each, s."""
        times = np.concatenate(([0.0], np.cumsum(self._model.cruise_time(way[:-1], way[1:]))))
        at = np.linspace(0.0, times[-1], WAY_POINTS)
        return np.column_stack([np.interp(at, times, joint) for joint in way.T]), times[-1] - at


class BridgeDistance:
    """Minus the distance straight to the goal line, m: the naive one, for comparison."""

    def __init__(self, task: BridgeTask) -> None:
        self._task = task

    def begin(self, ids: Ids) -> None:
        """Nothing to prepare."""

    def potentials(self, ids: Ids) -> Array:
        """In m, (len(ids),)."""
        return -np.maximum(self._task.state.distance[ids], 0.0)


class CrossingToGo:
    """Minus the length of the shortest way to the goal line around the blocks, m."""

    def __init__(self, task: BridgeTask) -> None:
        self._task = task
        bridge = task.map(0)
        self._lattice = Lattice(bridge.length, bridge.half_width)
        self._lengths = np.zeros((len(task.state.poses), *self._lattice.shape))

    def begin(self, ids: Ids) -> None:
        """Find the lengths from all over the bridges."""
        for i in ids:
            self._lengths[i] = self._lattice.lengths(self._task.map(int(i)), self._task.goal_x, CLEARANCE)

    def potentials(self, ids: Ids) -> Array:
        """In m, (len(ids),)."""
        return -self._lattice.interpolate(self._lengths[ids], self._task.state.poses[ids, :2])


ORACLES: tuple[tuple[str, type[Any], Callable[[Any], Oracle]], ...] = (
    ("distance", ReachTask, ReachDistance),
    ("ik", ReachTask, LeastTime),
    ("mpc", ReachTask, MpcCost),
    ("ompl", ReachObstaclesTask, WayToGo),
    ("distance", BridgeTask, BridgeDistance),
    ("ompl", BridgeTask, CrossingToGo),
)
"""Name, the tasks that it has a say in, and what makes it."""


def oracle_names(worlds: TaskVectorEnv) -> list[str]:
    """Names of the oracles that have a say in an environment."""
    return [name for name, task, _ in ORACLES if isinstance(worlds.task, task)]


def make_oracle(oracle: str | OracleFactory, worlds: TaskVectorEnv) -> Oracle:
    """An oracle by name, or by a function from the environment to it.

    Raises `ConfigurationError` for a name that is unknown, or has no say in this environment.
    """
    if callable(oracle):
        return oracle(worlds)
    for name, task, make in ORACLES:
        if name == oracle and isinstance(worlds.task, task):
            return make(worlds.task)
    raise unknown_name(
        f"shaping of {worlds.spec.id if worlds.spec else 'this environment'}", oracle, oracle_names(worlds)
    )
