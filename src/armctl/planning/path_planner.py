"""Shortest ways over a bridge, by OMPL: the only code that imports it.

RRT-Connect (Kuffner and LaValle 2000) finds ways through the blocks; each is pulled taut, and the shortest is taken.
Edges are checked exactly, by the map's distance to whole segments, so that a path has its clearance everywhere.
"""

import functools
import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.errors import ConfigurationError, unknown_name
from armctl.planning.bridge_map import BridgeMap, EdgeTest, is_point

Array = NDArray[np.float64]


PLANNERS = ("RRTConnect", "BITstar", "InformedRRTstar", "RRTstar")
RANGE = 3.0
"""Longest edge that a tree grows by, m."""


GOALS = 11
"""Points of the goal line that a path may lead to."""


@dataclass(frozen=True)
class PathPlannerOptions:
    """Options of `plan_path`."""

    clearance: float = 0.4
    """From the path to the nearest block or side, m."""
    planner: str = "RRTConnect"
    """One of `PLANNERS`. All but the first are optimal in the limit, and use up the time of `seconds`."""
    seconds: float = 1.0
    """Wall-clock budget of the optimal planners, whose paths therefore depend on the machine."""
    tries: int = 3
    """Ways that RRT-Connect is asked for; the shortest is taken."""
    seed: int = 1
    """Of OMPL's random numbers, from 1 on."""
    edges: int = 20_000
    """That RRT-Connect may check for one way."""
    spacing: float = 0.5
    """Of the points between which a way is pulled taut, m."""

    def __post_init__(self) -> None:
        if self.planner not in PLANNERS:
            raise unknown_name("planner", self.planner, PLANNERS)
        for name in ("clearance", "seconds", "tries", "seed", "edges", "spacing"):
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
                raise ConfigurationError(f"{name} is a number above 0, not {value!r}")


@dataclass(frozen=True, eq=False)
class PlanResult:
    """What planning has found; a failure is a result without a path."""

    path: Array
    """Corners of the path from start to goal, (m, 2), m; (0, 2) for a failure."""
    length: float
    """m; infinite for a failure."""
    clearance: float
    """That the path was planned with, m: less than asked for where the start is nearer to something."""
    edges: int
    """Checked by OMPL."""
    seconds: float

    @property
    def found(self) -> bool:
        """Whether there is a path."""
        return len(self.path) > 0


def plan_path(
    bridge: BridgeMap, start: ArrayLike, goal_x: float, options: PathPlannerOptions | None = None
) -> PlanResult:
    """Plan from `start` (2,) to the line x = `goal_x`, m, wherever on it.

    If the start is nearer to a block than the clearance, the path has as much clearance as the start. The same map,
    start and options give the same path, whatever was planned before.

    Raises `ConfigurationError` for a start or goal that is no place on the deck.
    """
    options = options or PathPlannerOptions()
    begin = time.perf_counter()
    if not is_point(start) or not np.isfinite(goal_x):
        raise ConfigurationError(f"a path leads from a point (x, y) to a line x, not from {start!r} to {goal_x!r}")
    origin = np.asarray(start, dtype=float)
    room = float(bridge.clearance(origin[None])[0])
    if room <= 0 or not origin[0] < goal_x < bridge.length:
        raise ConfigurationError(
            f"there is no way from {origin} to x = {goal_x} on a deck of {bridge.length} m: the start is to be on the "
            "free deck, and the goal ahead of it"
        )
    clearance = min(options.clearance, 0.999 * room)
    free = bridge.edge_test(clearance)
    goals = _goals(bridge, goal_x, clearance)
    ways, edges = [], 0
    for attempt in range(options.tries if options.planner == PLANNERS[0] else 1):
        way, checked = _find_way(bridge, origin, goals, clearance, options, options.seed + attempt)
        edges += checked
        if way is not None:
            ways.append(_shortcut(free, way, goals))
    path = _pulled_taut(free, min(ways, key=_length), goals, options.spacing) if ways else np.zeros((0, 2))
    return PlanResult(path, _length(path) if ways else np.inf, clearance, edges, time.perf_counter() - begin)


def _length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _find_way(
    bridge: BridgeMap, start: Array, goals: Array, clearance: float, options: PathPlannerOptions, seed: int
) -> tuple[Array | None, int]:
    """A way by OMPL, corners (m, 2), and the number of edges it checked."""
    ompl = _load_ompl()
    ompl.util.RNG.setSeed(seed)  # of all generators made from here on; that older ones keep theirs, it calls an error
    space = ompl.base.RealVectorStateSpace(2)
    bounds = ompl.base.RealVectorBounds(2)
    side = bridge.half_width - clearance
    for axis, (low, high) in enumerate(((min(start[0], clearance), bridge.length - clearance), (-side, side))):
        bounds.setLow(axis, float(low))
        bounds.setHigh(axis, float(high))
    space.setBounds(bounds)
    information = ompl.base.SpaceInformation(space)
    checker = ompl.EdgeChecker(information, bridge, clearance)
    information.setMotionValidator(checker)
    information.setStateValidityChecker(ompl.StateChecker(information, bridge, clearance))
    information.setup()
    problem = ompl.base.ProblemDefinition(information)
    first = _state(space, start)
    region = ompl.base.GoalStates(information)
    for goal in goals:
        region.addState(_state(space, goal))
    problem.addStartState(first)
    problem.setGoal(region)
    problem.setOptimizationObjective(ompl.base.PathLengthOptimizationObjective(information))
    planner = getattr(ompl.geometric, options.planner)(information)
    planner.setProblemDefinition(problem)
    if options.planner != "BITstar":
        planner.setRange(RANGE)
    planner.setup()
    if options.planner == PLANNERS[0]:
        planner.solve(ompl.base.PlannerTerminationCondition(lambda: checker.edges >= options.edges))
    else:
        planner.solve(options.seconds)
    if not problem.hasExactSolution():
        return None, checker.edges
    return np.array([state[0:2] for state in problem.getSolutionPath().getStates()]), checker.edges


def _goals(bridge: BridgeMap, x: float, clearance: float) -> Array:
    """Free points (g, 2) on the goal line."""
    y = np.linspace(-1, 1, GOALS) * (bridge.half_width - clearance)
    points = np.column_stack((np.full_like(y, x), y))
    return np.asarray(points[bridge.clearance(points) >= clearance * (1 - 1e-9)])


def _state(space: Any, point: ArrayLike) -> Any:
    state = space.allocState()
    state[0], state[1] = (float(number) for number in np.asarray(point))
    return state


def _pulled_taut(free: EdgeTest, way: Array, goals: Array, spacing: float) -> Array:
    """The way with its corners moved in, by shortcuts between points all along it, until it gets no shorter."""
    while True:
        shorter = _shortcut(free, _subdivided(way, spacing), goals)
        if _length(shorter) > 0.999 * _length(way):
            return shorter
        way = shorter


def _shortcut(free: EdgeTest, way: Array, goals: Array) -> Array:
    """The shortest way from the first corner of `way`, over others that see each other, to one of the goals."""
    nodes = np.vstack((way[:-1], goals)).tolist()
    first_goal = len(way) - 1
    distance, before = [0.0] + [math.inf] * (len(nodes) - 1), [0] * len(nodes)
    for i, (ax, ay) in enumerate(nodes[:first_goal]):
        for j in range(i + 1, len(nodes)):
            bx, by = nodes[j]
            longer = distance[i] + math.hypot(bx - ax, by - ay)
            if longer < distance[j] and free(ax, ay, bx, by):
                distance[j], before[j] = longer, i
    taut = [min(range(first_goal, len(nodes)), key=distance.__getitem__)]
    while taut[-1] != 0:
        taut.append(before[taut[-1]])
    return np.array([nodes[i] for i in reversed(taut)])


def _subdivided(way: Array, spacing: float) -> Array:
    steps = np.maximum(np.ceil(np.linalg.norm(np.diff(way, axis=0), axis=1) / spacing).astype(int), 1)
    pieces = [a + (b - a) * (np.arange(n) / n)[:, None] for a, b, n in zip(way[:-1], way[1:], steps, strict=True)]
    return np.vstack([*pieces, way[-1:]])


@functools.cache
def _load_ompl() -> Any:
    """OMPL, quiet, with checkers that ask a map."""
    from types import SimpleNamespace

    from ompl import base, geometric, util  # loads in 0.1 s, which only a planner should wait for

    util.noOutputHandler()

    class EdgeChecker(base.MotionValidator):  # type: ignore[misc]
        """Counts the edges that it checks."""

        def __init__(self, information: Any, bridge: BridgeMap, clearance: float) -> None:
            super().__init__(information)
            self._free = bridge.edge_test(clearance)
            self.edges = 0

        def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802
            self.edges += 1
            return self._free(a[0], a[1], b[0], b[1])

    class StateChecker(base.StateValidityChecker):  # type: ignore[misc]
        def __init__(self, information: Any, bridge: BridgeMap, clearance: float) -> None:
            super().__init__(information)
            self._free = bridge.edge_test(clearance)

        def isValid(self, state: Any) -> bool:  # noqa: N802
            return self._free(state[0], state[1], state[0], state[1])

    return SimpleNamespace(
        base=base, geometric=geometric, util=util, EdgeChecker=EdgeChecker, StateChecker=StateChecker
    )
