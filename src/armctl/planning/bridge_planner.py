"""Plans short paths over a bridge by OMPL.

FMT* (Janson, Schmerling, Clark and Pavone, "Fast marching tree", IJRR 2015) searches a fixed set of points. That makes
the search repeatable and needs fewer points than random sampling (Janson, Ichter and Pavone, "Deterministic
sampling-based motion planning", IJRR 2018). The points lie around the blocks, where short paths bend (Amato and Wu,
ICRA 1996), in the middle of narrow gaps (the bridge test of Hsu et al., ICRA 2003), and all over the deck. Edges are
checked by their exact clearance.

OMPL calls Python for each edge, which takes most of the time of a search. So a compiled FMT*, which finds the same path
as OMPL's, first searches all points; OMPL plans over the corners of that path, shortened, and checks each of its edges.
"""

import math
import time
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from ompl import base, geometric
from pydantic import Field

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import Positive, options
from armctl.kernels import bridge as kernel
from armctl.planning.ompl_setup import OmplProblem
from armctl.scene import BridgeMap

ARC = np.radians((0.0, 30.0, 60.0, 90.0))
"""Angles of the points around a block's corner; chords between them keep clear of it."""
THROAT = np.array((-0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5))
"""m: offsets of the points in a narrow gap from its middle, along the passage."""
NARROW = 1.2
"""Gaps narrower than this factor times the least passable width get points of their own."""
GOLDEN = (math.sqrt(5) - 1) / 2
"""Golden ratio, whose multiples spread points evenly over the deck: a Fibonacci lattice."""
GOALS = 9
"""Points on the goal line."""
RADIUS_MULTIPLIER = 1.5
"""FMT*'s factor on its connection radius: with it, each of 60 points has 50 neighbours, each of 120 points 58."""
ESCAPE_DISTANCES, ESCAPE_ANGLES = np.linspace(0.02, 2.0, 100), np.linspace(-np.pi, np.pi, 48, endpoint=False)
ESCAPE_DIRECTIONS = np.column_stack((np.cos(ESCAPE_ANGLES), np.sin(ESCAPE_ANGLES)))
ESCAPES = (ESCAPE_DISTANCES[:, None, None] * ESCAPE_DIRECTIONS).reshape(-1, 2)
"""m: offsets at which points with clearance are searched if the start has none."""
CELL = 0.05
"""m: size of the cells in which it is seen that there is no path."""
JITTER, ROUNDING = 1e-8, 1e-7
"""m: tolerances on distances, so that a gap of just the width needed counts as passable."""


@options
class PathPlannerOptions:
    """Options of `plan_path`."""

    clearance: Positive = 0.4
    """m: distance from the path to the nearest block or side."""
    searches: tuple[Annotated[int, Field(ge=0)], ...] = (0, 100, 400, 1600)
    """Points all over the deck in each search. Further searches follow until there is a path."""


@dataclass(frozen=True, eq=False)
class PlanResult:
    """The result of planning; a failure is a result without a path."""

    path: Array
    """Corners of the path from start to goal, (m, 2), m; (0, 2) for a failure."""
    length: float
    """m; infinite for a failure."""
    clearance: float
    """m: least along the path; below the requested one only if it is so at the start."""
    edges: int
    """Edges checked by OMPL, of the path and between its corners."""
    seconds: float
    """Planning time."""

    @property
    def solved(self) -> bool:
        """True if there is a path."""
        return len(self.path) > 0


def plan_path(
    bridge: BridgeMap, start: ArrayLike, goal_x: float, options: PathPlannerOptions | None = None
) -> PlanResult:
    """Plan from `start` (2,) m to any point on the line x = `goal_x` m, beside the lanes along the bridge.

    If the start lacks the clearance, the path first leads straight to the nearest point that has it, going no nearer to
    any block. If no path continues from there, one is planned with the start's own clearance. The same arguments give
    the same path.

    Raises `ConfigurationError` for a start or goal off the deck.
    """
    options, begin = options or PathPlannerOptions(), time.perf_counter()
    origin = _checked_start(bridge, start, goal_x)
    blocked, clearance = bridge.with_lanes_blocked(), options.clearance - ROUNDING
    room = float(bridge.clearance(origin[None])[0])
    first_leg = _to_open_deck(bridge, blocked, origin, clearance, min(room - ROUNDING, clearance))
    path, edges = np.zeros((0, 2)), 0
    for spread in options.searches if len(first_leg) else ():
        path, checked = _search(blocked, first_leg[-1], goal_x, clearance, _points(blocked, options.clearance, spread))
        edges += checked
        if len(path) or not kernel.may_pass(blocked.deck, clearance, first_leg[-1], goal_x, CELL):
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
        raise ConfigurationError(f"start should be a point (x, y) and goal_x a number, not {start!r} and {goal_x!r}")
    if not (bridge.clearance(origin[None])[0] > 0 and origin[0] < goal_x <= bridge.length):
        raise ConfigurationError(
            f"no path from {origin} to x = {goal_x} on a deck of {bridge.length} m: the start should be on the free "
            "deck, and the goal ahead of it"
        )
    return origin


def _length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) if len(path) else math.inf


def _to_open_deck(bridge: BridgeMap, blocked: BridgeMap, start: Array, clearance: float, room: float) -> Array:
    """Return the segment from the start to the nearest point with the clearance, keeping `room` from blocks.

    (2, 2), or (1, 2) if the start has the clearance, or (0, 2) if there is no such point.
    """
    if blocked.clearance(start[None])[0] >= clearance:
        return start[None]
    first = kernel.first_open(blocked.deck, clearance, bridge.deck, room, start, ESCAPES)
    return np.vstack((start, start + ESCAPES[first])) if first >= 0 else np.zeros((0, 2))


def _points(bridge: BridgeMap, clearance: float, spread: int) -> Array:
    """Return the points (m, 2) of a search."""
    corners = bridge.corners
    radius = (clearance + ROUNDING) / math.cos(ARC[1] / 2)
    angles = bridge.blocks[:, 2, None, None] + np.radians((0, 90, 180, 270))[:, None] + ARC
    around = corners[:, :, None] + radius * np.stack((np.cos(angles), np.sin(angles)), axis=-1)

    flat = corners.reshape(-1, 1, 2)
    across = bridge.nearest(flat[:, 0]) - flat
    width = np.linalg.norm(across, axis=-1)
    narrow = (width >= 2 * (clearance - ROUNDING)) & (width < NARROW * 2 * clearance)
    across, width, ends = across[narrow], width[narrow], flat[np.nonzero(narrow)[0], 0]
    middles = ends + across / 2
    through = across[:, ::-1] * (1, -1) / np.maximum(width, clearance)[:, None]
    throats = middles[:, None] + THROAT[:, None] * through[:, None]

    index, side = np.arange(spread), bridge.half_width - clearance
    everywhere = np.column_stack((bridge.length * (index + 0.5) / spread, side * (2 * (index * GOLDEN % 1) - 1)))
    return np.vstack((around.reshape(-1, 2), throats.reshape(-1, 2), everywhere))


def _search(bridge: BridgeMap, start: Array, goal_x: float, clearance: float, points: Array) -> tuple[Array, int]:
    """Return the path over points (m, 2) that FMT* finds, (k, 2) or (0, 2), and the number of edges OMPL checked."""
    side = bridge.half_width - clearance
    goals = np.append(np.linspace(-side, side, GOALS), np.clip(start[1], -side, side))
    points = np.vstack((points[points[:, 0] < goal_x], np.column_stack((np.full(len(goals), goal_x), goals))))
    points = points[bridge.clearance(points) >= clearance]
    # Among equally near neighbours, OMPL takes the one with the lower memory address: jitter avoids ties.
    points = points + JITTER * np.random.default_rng(0).random(points.shape)
    points[:, 0] = np.minimum(points[:, 0], goal_x)

    path = _march(bridge, np.vstack((start, points)), goal_x, clearance)
    if not len(path):
        return path, 0
    return _by_ompl(
        bridge, bridge.shortened(path, points, points[points[:, 0] >= goal_x], clearance), goal_x, clearance
    )


def _by_ompl(bridge: BridgeMap, points: Array, goal_x: float, clearance: float) -> tuple[Array, int]:
    """Return the path that OMPL's FMT* finds over points (n, 2) from the first one, and the number of edges checked."""
    is_free = bridge.edge_test(clearance)
    low, high = np.array((0.0, -bridge.half_width)), np.array((bridge.length, bridge.half_width))
    problem = OmplProblem(low, high, lambda a, b: is_free(a[0], a[1], b[0], b[1]), points[0])
    planner = geometric.FMT(problem.information)
    planner.setNumSamples(0)
    planner.setExtendedFMT(False)  # no random points
    planner.setRadiusMultiplier(RADIUS_MULTIPLIER)
    goal = _GoalLine(problem.information, goal_x, points[1:])
    # FMT* terminates by itself when it has no points left
    return problem.solve(planner, goal, base.plannerNonTerminatingCondition()), problem.edges_checked


def _march(bridge: BridgeMap, points: Array, goal_x: float, clearance: float) -> Array:
    """Return the path that `_by_ompl` returns, compiled."""
    neighbors = math.ceil((2 * RADIUS_MULTIPLIER) ** 2 * (math.e / 2) * math.log(len(points)))
    parents = np.empty(len(points), dtype=np.int64)
    last = kernel.march((*bridge.deck, clearance), points, goal_x, neighbors, parents)
    indices = [last] if last >= 0 else []
    while last > 0:
        last = parents[last]
        indices.append(last)
    return np.asarray(points[indices[::-1]])


class _GoalLine(base.GoalSampleableRegion):  # type: ignore[misc]
    """All points beyond a line. From Python only goals can be sampled, so all points of the search come from here."""

    def __init__(self, information: Any, x: float, points: Array) -> None:
        super().__init__(information)
        self._x, self._points, self._count = x, iter(points.tolist()), len(points)

    def distanceGoal(self, state: Any) -> float:  # noqa: N802
        return float(max(self._x - state[0], 0.0))

    def sampleGoal(self, state: Any) -> None:  # noqa: N802
        state[0], state[1] = next(self._points)

    def maxSampleCount(self) -> int:  # noqa: N802
        return self._count
