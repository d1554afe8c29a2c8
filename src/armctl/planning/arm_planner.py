"""Plans an arm's path around boxes to a target of the end-effector: a straight motion if possible, else OMPL.

RRT-Connect (Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000) grows
trees from the start and from configurations in the sphere around the target: a sphere of positions, or of the places
of poses if the search is a `MinimumTimePose`. Shortcuts then straighten the path (Geraerts and Overmars, "Creating
high-quality paths for motion planning", IJRR 2007). `EdgeChecker` checks edges continuously.
"""

import itertools
import math
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from ompl import geometric
from pydantic import Field

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, Positive, options
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker, MinimumTimeReach
from armctl.kinematics.edge_checker import MAX_CLEARANCE
from armctl.planning.arm_search import ArmSearch
from armctl.scene import Boxes

DETOUR = 2.0
"""rad: margin of the search space beyond start and goals."""
INSIDE = 0.8
"""Fraction of the sphere's radius within which the arm comes to rest."""
MAX_TIME_RATIO = 0.99
"""A shortcut is taken if it needs less than this fraction of the time."""


@options
class ArmPlannerOptions:
    """Options of an `ArmPlanner`."""

    clearance: Annotated[float, Field(gt=0, le=MAX_CLEARANCE)] = 0.01
    """m: distance from boxes, floor and the arm itself along the whole path."""
    direct: Annotated[int, Field(ge=0)] = 12
    """Number of goals, the earliest first, to which a straight motion is tried before any search."""
    goals: Count = 32
    """Number of goals, the earliest first, from which a search grows trees."""
    checks: Annotated[int, Field(ge=0)] = 6000
    """Collision checks after which a search gives up."""
    stride: Positive = 1.0
    """rad: longest edge of a tree."""
    shortcuts: Annotated[int, Field(ge=0)] = 100
    """Number of shortcuts tried."""
    seed: Count = 1
    """Random seed of a search."""


@dataclass(frozen=True, eq=False)
class ArmPlan:
    """The result of planning; a failure is a plan without a path."""

    path: Array
    """Corners from the start into the sphere, (m, dof) rad; (0, dof) for a failure."""
    time: float
    """Seconds for the path, each edge at the velocity limit of its slowest joint; infinite for a failure."""
    raw_time: float
    """The same before shortcuts."""
    clearance: float
    """m: least distance from boxes and floor at the path's corners; NaN for a failure."""
    searched: bool
    """True if no straight motion was free, so that OMPL searched."""
    checks: int
    """Configurations checked for collisions."""
    seconds: float
    """Planning time."""

    @property
    def solved(self) -> bool:
        """True if there is a path."""
        return len(self.path) > 0


class ArmPlanner:
    """Plans paths of one arm to targets of its `search`, by default to positions. Not thread-safe."""

    def __init__(
        self, model: ArmModel, options: ArmPlannerOptions | None = None, search: MinimumTimeReach | None = None
    ) -> None:
        self.model, self.options = model, options or ArmPlannerOptions()
        self._minimum_time, self._shapes = search or MinimumTimeReach(model), ArmShapes(model)

    def plan(self, start: ArrayLike, target: ArrayLike, tolerance: float, boxes: Boxes) -> ArmPlan:
        """Plan from `start` (dof,) rad until the tip is within `tolerance` (m) of the place `target`, (3,) or (12,) m.

        Whatever is nearer to the arm at the start than twice the clearance must keep only half of that distance. The
        same arguments give the same path, and the number of steps is bounded.

        Raises `ConfigurationError` for a start outside the limits, and for an invalid sphere.
        """
        begin = time.perf_counter()
        origin, centre = self._checked(start, target, tolerance)
        edges = EdgeChecker(self._shapes, boxes, self.options.clearance, origin)
        path, raw, searched = np.zeros((0, self.model.dof)), math.inf, False
        if edges.start_is_free:
            if np.linalg.norm(self._minimum_time.place(origin) - centre) <= tolerance:
                path = origin[None]
            else:
                goals = self._goals(edges, origin, centre, tolerance)
                path, tried = self._straight(edges, origin, itertools.islice(goals, self.options.direct))
                if searched := not len(path) and len(tried) > 0:
                    path = self._search(edges, origin, np.array([*tried, *goals]))
            raw = self._time(path)
            path = self._shortened(edges, path, centre, tolerance)
        clearance = edges.clearance(path) if len(path) else math.nan
        seconds = time.perf_counter() - begin
        return ArmPlan(path, self._time(path), raw, clearance, searched, edges.checks, seconds)

    def _checked(self, start: ArrayLike, target: ArrayLike, tolerance: float) -> tuple[Array, Array]:
        try:
            origin, centre, radius = (np.asarray(values, dtype=float) for values in (start, target, tolerance))
        except (TypeError, ValueError):
            origin = centre = radius = np.empty(0)
        if origin.shape != (self.model.dof,) or not self.model.within_limits(origin):
            raise ConfigurationError(f"start should be {self.model.dof} positions within the limits, not {start!r}")
        if (
            centre.shape != self._minimum_time.place(origin).shape
            or radius.shape != ()
            or not np.isfinite(centre).all()
            or not 0 < radius < math.inf
        ):
            raise ConfigurationError(
                f"target and tolerance should be (x, y, z), or the place of a pose, and a radius above 0, "
                f"not {target!r} and {tolerance!r}"
            )
        return origin, centre

    def _goals(self, edges: EdgeChecker, start: Array, centre: Array, radius: float) -> Iterator[Array]:
        """Yield free configurations (dof,) in the sphere, the earliest first, then those around the centre."""
        search, inside = self._minimum_time, INSIDE * radius
        q = self._by_time(start, search.configurations(start, centre))
        earliest = search.refined(start, q[: self.options.goals], centre, inside)[0]
        beside = (self._by_time(start, search.configurations(start, at)) for at in search.around(centre, inside))
        groups = itertools.chain((self._by_time(start, np.vstack((earliest, q))),), beside)
        free = filter(edges.is_free, itertools.chain.from_iterable(groups))
        return itertools.islice(free, self.options.goals)

    def _by_time(self, start: Array, q: Array) -> Array:
        q = q[self.model.within_limits(q)]
        return np.asarray(q[np.argsort(self.model.cruise_time(start, q), kind="stable")])

    def _straight(self, edges: EdgeChecker, start: Array, goals: Iterable[Array]) -> tuple[Array, list[Array]]:
        """Return the straight motion to the first goal with a free one, (2, dof) or (0, dof); and the goals tried."""
        tried = []
        for goal in goals:
            tried.append(goal)
            if edges.is_edge_free(start, goal):
                return np.array((start, goal)), tried
        return np.zeros((0, self.model.dof)), tried

    def _search(self, edges: EdgeChecker, start: Array, goals: Array) -> Array:
        """Return the path that RRT-Connect finds, (m, dof), or (0, dof)."""
        options = self.options
        search = ArmSearch(geometric.RRTConnect, options.seed, DETOUR, options.stride, options.checks)
        return search.path(edges, self.model.limits, start, goals)

    def _shortened(self, edges: EdgeChecker, path: Array, centre: Array, radius: float) -> Array:
        """Return the path with random shortcuts and another end, where they save time."""
        if len(path) > 2:
            for draws in np.array_split(np.random.default_rng(0).random((self.options.shortcuts, 2)), 2):
                path = edges.shortened(path, draws, MAX_TIME_RATIO)
                path = self._with_earlier_end(edges, path, centre, radius)
        return path

    def _with_earlier_end(self, edges: EdgeChecker, path: Array, centre: Array, radius: float) -> Array:
        """Return the path, left at the corner from which a straight motion into the sphere saves most time."""
        corners = path[:-1]
        ends = self._minimum_time.refined(corners, np.tile(path[-1], (len(corners), 1)), centre, INSIDE * radius)[0]
        times = self.model.cruise_time(corners[:, None], ends) + self._times(path)[:-1, None]
        longest = MAX_TIME_RATIO * self._time(path)
        for i, j in zip(*np.unravel_index(np.argsort(times, axis=None), times.shape), strict=True):
            if times[i, j] > longest:
                break
            if edges.is_edge_free(corners[i], ends[j]):
                return np.vstack((path[: i + 1], ends[j]))
        return path

    def _times(self, path: Array) -> Array:
        """Return the seconds from the start to each corner, (m,)."""
        return np.concatenate(([0.0], np.cumsum(self.model.cruise_time(path[:-1], path[1:]))))

    def _time(self, path: Array) -> float:
        return float(self._times(path)[-1]) if len(path) else math.inf
