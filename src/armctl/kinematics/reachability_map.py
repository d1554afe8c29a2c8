"""Sampled configurations of an arm, looked up by end-effector position: a global search before a local one."""

import itertools

import numpy as np
import scipy
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.reach import TIP_SPEED
from armctl.kinematics.edge_checker import ArmShapes, EdgeChecker
from armctl.kinematics.ik import Ik
from armctl.kinematics.minimum_time_reach import approach
from armctl.kinematics.model import ArmModel
from armctl.scene import Boxes

CONFIGURATIONS = 4096
MAX_DRAWS = 50
"""Draws per configuration: an arm that seldom avoids itself gets fewer configurations."""
NEIGHBOURS, CANDIDATES = 128, 16
"""Configurations with the end-effector nearest to the target; of these, those reached earliest, which are refined."""
AMONG_BOXES, DETOURS = 128, 4000
"""Candidates among boxes; ways with one configuration in between that are tried if no straight motion is free."""
CLEARANCE = 0.01
"""m, of such motions from boxes, floor and the arm itself."""
ITERATIONS = 4
"""Levenberg-Marquardt iterations from a candidate to the target."""
ON_TARGET, MISS_PENALTY = 0.01, 10.0
"""m: largest final error of a refined candidate; s: what a larger error adds to its time."""


class ReachabilityMap:
    """`count` configurations, uniform within the joint limits and +-pi, with their end-effector positions.

    With `collision_free`, the arm touches neither itself nor the floor in any of them.
    """

    def __init__(self, model: ArmModel, count: int = CONFIGURATIONS, collision_free: bool = True) -> None:
        self.model = model
        rng = np.random.default_rng(0)
        batches = (model.random_configurations(rng, count) for _ in range(MAX_DRAWS))
        kept = (batch[model.are_free(batch)] if collision_free else batch for batch in batches)
        self.configurations: Array = np.array(list(itertools.islice(itertools.chain.from_iterable(kept), count)))
        """(count, dof) rad"""
        self._shapes, self._ik = ArmShapes(model), Ik(model)
        self._by_position = scipy.spatial.KDTree(model.positions(self.configurations))

    def nearest(self, positions: Array, count: int) -> tuple[Array, NDArray[np.intp]]:
        """Return distances (..., count) m and indices of the configurations nearest to `positions`."""
        distances, indices = self._by_position.query(positions, count)
        return np.asarray(distances), np.asarray(indices)

    def towards(self, target: Array, start: Array, among: ArmModel) -> Array:
        """Return the configuration (dof,) at `target` (3,) that is reached earliest from `start` (dof,).

        The straight path to it is free in the model `among`, if such a candidate was found.
        """
        goals = self.goals(target, start, CANDIDATES)
        fractions = np.linspace(1.0, 0.1, 10)[:, None]
        free = (goal for goal in goals if among.are_free(start + fractions * (goal - start)).all())
        return np.asarray(next(free, goals[0]))

    def way(self, target: Array, start: Array, boxes: Boxes) -> Array:
        """Return configurations (k, dof) to pass from `start` on, the last with the end-effector at `target` (3,).

        Straight motions from one to the next keep clear of boxes, floor and the arm itself. There are one or two, or
        none if no such way was found.
        """
        edges = EdgeChecker(self._shapes, boxes, CLEARANCE, start)
        goals = self.goals(target, start, AMONG_BOXES)
        goals = goals[np.linalg.norm(self.model.positions(goals) - target, axis=1) < ON_TARGET]
        way = self._through(edges, start, goals)
        return way if len(way) else self._through(edges, start, self._ik_goals(target, start))

    def _through(self, edges: EdgeChecker, start: Array, goals: Array) -> Array:
        """Return the way (k, dof) to one of `goals` (n, dof): straight or with one corner; (0, dof) if none."""
        goals = np.array([goal for goal in goals if edges.is_free(goal)]).reshape(-1, self.model.dof)
        for goal in goals:
            if edges.is_edge_free(start, goal):
                return np.asarray(goal[None])
        first = self.model.cruise_time(start, self.configurations)
        times = first[:, None] + self.model.cruise_time(self.configurations[:, None], goals)
        earliest = np.argsort(times, axis=None, kind="stable")[:DETOURS]
        for detour, goal in zip(*np.unravel_index(earliest, times.shape), strict=True):
            through, end = self.configurations[detour], goals[goal]
            if edges.is_edge_free(start, through) and edges.is_edge_free(through, end):
                return np.array((through, end))
        return np.zeros((0, self.model.dof))

    def _ik_goals(self, target: Array, start: Array) -> Array:
        """Return configurations (n, dof) by inverse kinematics, those reached earliest first."""
        goals = np.array(list(self._ik.free_configurations(target))).reshape(-1, self.model.dof)
        goals = self.model.nearest_turn(goals, start)
        return np.asarray(goals[np.argsort(self.model.cruise_time(start, goals), kind="stable")])

    def goals(self, target: Array, start: Array, count: int) -> Array:
        """Return configurations (count, dof) with the end-effector at `target` (3,), those reached earliest first."""
        limits = self.model.limits
        distances, near = self.nearest(target, NEIGHBOURS)
        time = self.model.min_time(start, self.configurations[near]) + distances / TIP_SPEED
        earliest = self.configurations[near[np.argsort(time)[:count]]]
        goals = np.clip(approach(self.model, earliest, target, ITERATIONS), limits.lower, limits.upper)
        error = np.linalg.norm(self.model.positions(goals) - target, axis=1)
        time = self.model.min_time(start, goals) + np.where(error < ON_TARGET, 0.0, MISS_PENALTY)
        return np.asarray(goals[np.argsort(time)])
