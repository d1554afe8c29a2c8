"""Short ways over a bridge, by OMPL: the only code that imports it.

FMT* (Janson, Schmerling, Clark and Pavone, "Fast marching tree", IJRR 2015) searches points that are chosen, not drawn:
such a search repeats itself, and needs fewer of them (Janson, Ichter and Pavone, "Deterministic sampling-based motion
planning", IJRR 2018). They stand where short ways bend, around the blocks (Amato and Wu, ICRA 1996), in the middle of
narrow gaps (the bridge test of Hsu et al., ICRA 2003), and all over the deck. An edge is free by its exact clearance.
"""

import math
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base, geometric, util

from armctl.errors import ConfigurationError
from armctl.scene import BridgeMap, EdgeTest

Array = NDArray[np.float64]

util.noOutputHandler()  # what it has to say, results say

ARC = np.radians((0.0, 30.0, 60.0, 90.0))
"""Where points stand around a block's corner; chords between them keep clear of it."""
THROAT = np.array((-0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5))
"""Where points stand on the way through a narrow gap, m from its middle."""
NARROW = 1.2
"""Times the least width that a gap must have: wider ones need no points of their own."""
GOLDEN = (math.sqrt(5) - 1) / 2
"""Of the golden ratio, whose multiples spread points evenly over the deck: a Fibonacci lattice."""
GOALS = 9
"""Points on the goal line."""
NEIGHBOURS = 1.5
"""FMT*'s factor on the radius within which its theory wants neighbours: all points are, on maps of usual size."""
WAYS_OUT, DIRECTIONS = np.linspace(0.02, 2.0, 100), np.linspace(-np.pi, np.pi, 48, endpoint=False)
"""Distances, m, and angles at which places with clearance are looked for where the start has none."""
JITTER, ROUNDING = 1e-8, 1e-7
"""m by which distances may be off, so that a gap just wide enough is one."""


@dataclass(frozen=True)
class PathPlannerOptions:
    """Options of `plan_path`."""

    clearance: float = 0.4
    """From the path to the nearest block or side, m."""
    searches: tuple[int, ...] = (0, 100, 400, 1600)
    """How many points all over the deck each search has. Two are made, for FMT* leaves edges untried, and other ones
    each time; the shorter path is taken. Further ones are made until there is a path."""

    def __post_init__(self) -> None:
        if not (isinstance(self.clearance, (int, float)) and 0 < self.clearance < math.inf):
            raise ConfigurationError(f"clearance is a number of metres above 0, not {self.clearance!r}")


@dataclass(frozen=True, eq=False)
class PlanResult:
    """What planning has found; a failure is a result without a path."""

    path: Array
    """Corners of the path from start to goal, (m, 2), m; (0, 2) for a failure."""
    length: float
    """m; infinite for a failure."""
    clearance: float
    """Measured on all of the path, m; less than asked for only if the start has less."""
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
    """Plan from `start` (2,) to the line x = `goal_x`, m, wherever on it, past lanes along the bridge.

    A start nearer to something than the clearance is first left straight for the nearest place that is not, going no
    nearer to any block; if no path leads on from there, one is planned with no more clearance than the start has. The
    same arguments give the same path, whatever was planned before.

    Raises `ConfigurationError` for a start or goal that is no place on the deck.
    """
    options, begin = options or PathPlannerOptions(), time.perf_counter()
    origin = _checked_start(bridge, start, goal_x)
    blocked, clearance = bridge.with_lanes_blocked(), options.clearance - ROUNDING
    room = float(bridge.clearance(origin[None])[0])
    first_leg = _to_open_deck(bridge, blocked, origin, clearance, min(room - ROUNDING, clearance))
    path, edges = np.zeros((0, 2)), 0
    for searches, spread in enumerate(options.searches if len(first_leg) else (), start=1):
        way, checked = _search(blocked, first_leg[-1], goal_x, clearance, _points(blocked, options.clearance, spread))
        edges += checked
        path = min(path, way, key=_length)
        if searches > 1 and len(path):
            break
    if not len(path) and room < options.clearance:
        return plan_path(bridge, start, goal_x, replace(options, clearance=room))
    nearest = math.nan
    if len(path):
        path = np.vstack((first_leg[:-1], path))
        nearest = float(blocked.segment_clearance(path[:-1], path[1:]).min())
    return PlanResult(path, _length(path), nearest, edges, time.perf_counter() - begin)


def _checked_start(bridge: BridgeMap, start: ArrayLike, goal_x: float) -> Array:
    try:
        origin = np.asarray(start, dtype=float)
    except (TypeError, ValueError):
        origin = np.empty(0)
    if origin.shape != (2,) or not np.isfinite((*origin, goal_x)).all():
        raise ConfigurationError(f"a path leads from a point (x, y) to a line x, not from {start!r} to {goal_x!r}")
    if not (bridge.clearance(origin[None])[0] > 0 and origin[0] < goal_x <= bridge.length):
        raise ConfigurationError(
            f"there is no way from {origin} to x = {goal_x} on a deck of {bridge.length} m: the start is to be on the "
            "free deck, and the goal ahead of it"
        )
    return origin


def _length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) if len(path) else math.inf


def _to_open_deck(bridge: BridgeMap, blocked: BridgeMap, start: Array, clearance: float, room: float) -> Array:
    """The leg from the start to the nearest place with the clearance, and with `room` from blocks on the way there.

    (2, 2), or (1, 2) if the start has the clearance, or (0, 2) if there is no such place.
    """
    if blocked.clearance(start[None])[0] >= clearance:
        return start[None]
    distances, angles = (one.ravel() for one in np.meshgrid(WAYS_OUT, DIRECTIONS, indexing="ij"))
    places = start + distances[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    places = places[blocked.clearance(places) >= clearance]
    places = places[bridge.segment_clearance(np.broadcast_to(start, places.shape), places) >= room]
    return np.vstack((start, places[0])) if len(places) else places


def _points(bridge: BridgeMap, clearance: float, spread: int) -> Array:
    """Points to search, (m, 2)."""
    corners = bridge.corners
    radius = (clearance + ROUNDING) / math.cos(ARC[1] / 2)
    angles = bridge.blocks[:, 2, None, None] + np.radians((0, 90, 180, 270))[:, None] + ARC
    around = corners[:, :, None] + radius * np.stack((np.cos(angles), np.sin(angles)), axis=-1)

    flat = corners.reshape(-1, 1, 2)
    across = bridge.nearest(flat[:, 0]) - flat
    width = np.linalg.norm(across, axis=-1)
    narrow = (width >= 2 * (clearance - ROUNDING)) & (width < NARROW * 2 * clearance)
    middles = (flat + across / 2)[narrow]
    through = (across[..., ::-1] * (1, -1) / np.maximum(width, clearance)[..., None])[narrow]
    throats = middles[:, None] + THROAT[:, None] * through[:, None]

    index, side = np.arange(spread), bridge.half_width - clearance
    everywhere = np.column_stack((bridge.length * (index + 0.5) / spread, side * (2 * (index * GOLDEN % 1) - 1)))
    return np.vstack((around.reshape(-1, 2), throats.reshape(-1, 2), everywhere))


def _search(bridge: BridgeMap, start: Array, goal_x: float, clearance: float, points: Array) -> tuple[Array, int]:
    """The way over points (m, 2) that FMT* finds, (k, 2), or (0, 2), and the number of edges that it checked."""
    side = bridge.half_width - clearance
    goals = np.append(np.linspace(-side, side, GOALS), np.clip(start[1], -side, side))
    points = np.vstack((points[points[:, 0] < goal_x], np.column_stack((np.full(len(goals), goal_x), goals))))
    points = points[bridge.clearance(points) >= clearance]
    # Among neighbours equally near, OMPL takes that with the lower address in memory: let no two be.
    points = points + JITTER * np.random.default_rng(0).random(points.shape)
    points[:, 0] = np.minimum(points[:, 0], goal_x)

    space = base.RealVectorStateSpace(2)
    bounds = base.RealVectorBounds(2)
    for axis, (low, high) in enumerate(((0.0, bridge.length), (-bridge.half_width, bridge.half_width))):
        bounds.setLow(axis, low)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    edges = _Edges(information, bridge.edge_test(clearance))
    information.setMotionValidator(edges)
    information.setStateValidityChecker(base.AllValidStateValidityChecker(information))  # all of `points` are
    information.setup()

    problem = base.ProblemDefinition(information)
    state = space.allocState()
    state[0], state[1] = start.tolist()
    problem.addStartState(state)
    problem.setGoal(_GoalLine(information, goal_x, points))
    planner = geometric.FMT(information)
    planner.setNumSamples(0)
    planner.setExtendedFMT(False)  # no random points
    planner.setRadiusMultiplier(NEIGHBOURS)
    planner.setProblemDefinition(problem)
    planner.setup()
    planner.solve(base.plannerNonTerminatingCondition())  # FMT* ends by itself, when it has no points left
    if not problem.hasExactSolution():
        return np.zeros((0, 2)), edges.checked
    return np.array([state[0:2] for state in problem.getSolutionPath().getStates()]), edges.checked


class _Edges(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: Any, is_free: EdgeTest) -> None:
        super().__init__(information)
        self._is_free, self.checked = is_free, 0

    def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802
        self.checked += 1
        return self._is_free(a[0], a[1], b[0], b[1])


class _GoalLine(base.GoalSampleableRegion):  # type: ignore[misc]
    """All x from a line on; from Python, only goals can be sampled, and so all points to search come from here."""

    def __init__(self, information: Any, x: float, points: Array) -> None:
        super().__init__(information)
        self._x, self._points, self._count = x, iter(points.tolist()), len(points)

    def distanceGoal(self, state: Any) -> float:  # noqa: N802
        return float(max(self._x - state[0], 0.0))

    def sampleGoal(self, state: Any) -> None:  # noqa: N802
        state[0], state[1] = next(self._points)

    def maxSampleCount(self) -> int:  # noqa: N802
        return self._count
