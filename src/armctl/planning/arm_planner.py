"""Ways for an arm around boxes, until its end-effector is in a sphere: by straight motions, or else by OMPL.

RRT-Connect (Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning", ICRA 2000) grows
trees from the start and from configurations in the sphere; shortcuts then straighten what it finds (Geraerts and
Overmars, "Creating high-quality paths for motion planning", IJRR 2007). Motions are free without gaps: `EdgeChecker`.
"""

import itertools
import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base, geometric, util

from armctl.errors import ConfigurationError
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker, MinimumTimeReach
from armctl.kinematics.edge_checker import MOST_CLEARANCE
from armctl.scene import Boxes

Array = NDArray[np.float64]

util.noOutputHandler()  # what it has to say, results say

OMPL_SEED = 1
"""Of each search: the same arguments give the same path."""
DETOUR = 2.0
"""rad beyond start and goals in which ways around boxes are looked for."""
INSIDE = 0.8
"""Of the sphere's radius: the arm is to come to rest well within it."""
WORTH_IT = 0.99
"""Part of the time that a shortcut may take, at most."""


@dataclass(frozen=True)
class ArmPlannerOptions:
    """Options of an `ArmPlanner`."""

    clearance: float = 0.01
    """From boxes, floor and the arm itself, m, all along the path."""
    direct: int = 12
    """Goals, the soonest, to which a straight motion is tried before any search."""
    goals: int = 32
    """Goals, the soonest, from which a search grows trees."""
    checks: int = 6000
    """Configurations that a search checks for collisions before it gives up."""
    stride: float = 1.0
    """Longest motion that is added to a tree, rad."""
    shortcuts: int = 100
    """Straight motions with which it is tried to shorten a path."""

    def __post_init__(self) -> None:
        for name, most in (("clearance", MOST_CLEARANCE), ("stride", math.inf)):
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and 0 < value <= most):
                raise ConfigurationError(f"{name} is a number above 0 and up to {most}, not {value!r}")
        for name in ("direct", "goals", "checks", "shortcuts"):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= (name == "goals")):
                raise ConfigurationError(f"{name} is a whole number, not {value!r}")


@dataclass(frozen=True, eq=False)
class ArmPlan:
    """What planning has found; a failure is a plan without a path."""

    path: Array
    """Corners from the start into the sphere, (m, dof) rad; (0, dof) for a failure."""
    time: float
    """Seconds for the path, each motion at the velocity limit of its slowest joint; infinite for a failure."""
    raw_time: float
    """The same, before the path was shortened."""
    clearance: float
    """m from boxes and floor, measured at the path's corners; NaN for a failure."""
    searched: bool
    """Whether no straight motion did."""
    checks: int
    """Configurations that were checked for collisions."""
    seconds: float
    """That planning took."""

    @property
    def found(self) -> bool:
        """Whether there is a path."""
        return len(self.path) > 0


class ArmPlanner:
    """Plans for one arm. Not for several threads at once."""

    def __init__(self, model: ArmModel, options: ArmPlannerOptions | None = None) -> None:
        self.model, self.options = model, options or ArmPlannerOptions()
        self._touch, self._shapes = MinimumTimeReach(model), ArmShapes(model)

    def plan(self, start: ArrayLike, target: ArrayLike, tolerance: float, boxes: Boxes) -> ArmPlan:
        """Plan from `start` (dof,) rad until the end-effector is within `tolerance` of `target` (3,), m.

        What is nearer to the arm at the start than twice the clearance need keep only half of that distance. The same
        arguments give the same path, whatever was planned before, and planning ends within a bounded number of steps.

        Raises `ConfigurationError` for a start that is no configuration within the limits, and for no proper sphere.
        """
        begin = time.perf_counter()
        origin, centre = self._checked(start, target, tolerance)
        motions = EdgeChecker(self._shapes, boxes, self.options.clearance, origin)
        path, raw, searched = np.zeros((0, self.model.dof)), math.inf, False
        if motions.start_is_free:
            if np.linalg.norm(self.model.position(origin) - centre) <= tolerance:
                path = origin[None]
            else:
                goals = self._goals(motions, origin, centre, tolerance)
                path = self._straight(motions, origin, goals)
                if searched := not len(path) and len(goals) > 0:
                    path = self._search(motions, origin, goals)
            raw = self._time(path)
            path = self._shortened(motions, path, centre, tolerance)
        clearance = motions.clearance(path) if len(path) else math.nan
        seconds = time.perf_counter() - begin
        return ArmPlan(path, self._time(path), raw, clearance, searched, motions.checks, seconds)

    def _checked(self, start: ArrayLike, target: ArrayLike, tolerance: float) -> tuple[Array, Array]:
        try:
            origin, centre, radius = (np.asarray(one, dtype=float) for one in (start, target, tolerance))
        except (TypeError, ValueError):
            origin = centre = radius = np.empty(0)
        if origin.shape != (self.model.dof,) or not self.model.within_limits(origin):
            raise ConfigurationError(f"a start is {self.model.dof} joint positions within the limits, not {start!r}")
        if centre.shape != (3,) or radius.shape != () or not np.isfinite(centre).all() or not 0 < radius < math.inf:
            raise ConfigurationError(
                f"a sphere is a centre (x, y, z) and a radius above 0, not {target!r}, {tolerance!r}"
            )
        return origin, centre

    def _goals(self, motions: EdgeChecker, start: Array, centre: Array, radius: float) -> Array:
        """Free configurations (k, dof) in the sphere, those first that can be reached soonest."""
        q = np.array(list(self._touch.ik.configurations(centre))).reshape(-1, self.model.dof)
        q = self._by_time(start, self.model.nearest_turn(q, start))
        soonest = self._touch.sooner(start, q[: self.options.goals], centre, INSIDE * radius)
        free = (one for one in self._by_time(start, np.vstack((soonest, q))) if motions.is_free(one))
        return np.array(list(itertools.islice(free, self.options.goals))).reshape(-1, self.model.dof)

    def _by_time(self, start: Array, q: Array) -> Array:
        q = q[self.model.within_limits(q)]
        return np.asarray(q[np.argsort(self.model.cruise_time(start, q), kind="stable")])

    def _straight(self, motions: EdgeChecker, start: Array, goals: Array) -> Array:
        for goal in goals[: self.options.direct]:
            if motions.is_edge_free(start, goal):
                return np.array((start, goal))
        return np.zeros((0, self.model.dof))

    def _search(self, motions: EdgeChecker, start: Array, goals: Array) -> Array:
        """The path that RRT-Connect finds, (m, dof), or (0, dof)."""
        util.RNG.setSeed(OMPL_SEED)
        dof, limits = self.model.dof, self.model.limits
        ends = np.vstack((start, goals))
        space, bounds = base.RealVectorStateSpace(dof), base.RealVectorBounds(dof)
        for joint in range(dof):
            bounds.setLow(joint, max(limits.lower[joint], ends[:, joint].min() - DETOUR))
            bounds.setHigh(joint, min(limits.upper[joint], ends[:, joint].max() + DETOUR))
        space.setBounds(bounds)
        information = base.SpaceInformation(space)
        checker = _Motions(information, motions, dof)
        information.setMotionValidator(checker)
        information.setStateValidityChecker(base.AllValidStateValidityChecker(information))  # motions include both ends
        information.setup()

        def state(q: Array) -> Any:
            one = space.allocState()
            for joint, angle in enumerate(q.tolist()):
                one[joint] = angle
            return one

        problem = base.ProblemDefinition(information)
        problem.addStartState(state(start))
        region = base.GoalStates(information)
        for goal in goals:
            region.addState(state(goal))
        problem.setGoal(region)
        planner = geometric.RRTConnect(information)
        planner.setRange(self.options.stride)
        planner.setProblemDefinition(problem)
        planner.setup()
        last = motions.checks + self.options.checks
        planner.solve(base.PlannerTerminationCondition(lambda: motions.checks >= last))
        if not problem.hasExactSolution():
            return np.zeros((0, dof))
        return np.array([state[0:dof] for state in problem.getSolutionPath().getStates()])

    def _shortened(self, motions: EdgeChecker, path: Array, centre: Array, radius: float) -> Array:
        """The same path with shortcuts between random places on it, and another end, where they save time."""
        rng, tries = np.random.default_rng(0), range(self.options.shortcuts if len(path) > 2 else 0)
        for half in (tries[::2], tries[1::2]):
            for _ in half:
                path = self._with_shortcut(motions, path, rng)
            path = self._with_sooner_end(motions, path, centre, radius) if tries else path
        return path

    def _with_shortcut(self, motions: EdgeChecker, path: Array, rng: np.random.Generator) -> Array:
        times = self._times(path)
        places = np.sort(rng.uniform(0, times[-1], 2))
        i, j = corners = np.searchsorted(times, places, side="right")
        if i == j:
            return path
        part = (places - times[corners - 1]) / (times[corners] - times[corners - 1])
        a, b = path[corners - 1] + part[:, None] * (path[corners] - path[corners - 1])
        if self.model.cruise_time(a, b) < WORTH_IT * (places[1] - places[0]) and motions.is_edge_free(a, b):
            return np.vstack((path[:i], a, b, path[j:]))
        return path

    def _with_sooner_end(self, motions: EdgeChecker, path: Array, centre: Array, radius: float) -> Array:
        """The same path, left at the corner from which a straight motion into the sphere saves most time."""
        corners = path[:-1]
        ends = self._touch.sooner(corners, np.tile(path[-1], (len(corners), 1)), centre, INSIDE * radius)
        times = self.model.cruise_time(corners[:, None], ends) + self._times(path)[:-1, None]
        for i, j in zip(*np.unravel_index(np.argsort(times, axis=None), times.shape), strict=True):
            if times[i, j] > WORTH_IT * self._time(path):
                break
            if motions.is_edge_free(corners[i], ends[j]):
                return np.vstack((path[: i + 1], ends[j]))
        return path

    def _times(self, path: Array) -> Array:
        """Seconds from the start to each corner, (m,)."""
        return np.concatenate(([0.0], np.cumsum(self.model.cruise_time(path[:-1], path[1:]))))

    def _time(self, path: Array) -> float:
        return float(self._times(path)[-1]) if len(path) else math.inf


class _Motions(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: Any, motions: EdgeChecker, dof: int) -> None:
        super().__init__(information)
        self._motions, self._dof = motions, dof

    def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802
        return self._motions.is_edge_free(np.array(a[0 : self._dof]), np.array(b[0 : self._dof]))
