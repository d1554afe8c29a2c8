"""A search by OMPL in the space of an arm's joints, which is repeatable: its budget is a number of collision checks."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from ompl import base, util

from armctl.core.arrays import Array
from armctl.kinematics import EdgeChecker
from armctl.planning.ompl_setup import OmplProblem
from armctl.robot_description import JointLimits


@dataclass(frozen=True)
class ArmSearch:
    """Parameters of a search."""

    planner: Any
    """OMPL's planner, such as `ompl.geometric.RRTConnect`."""
    seed: int
    detour: float
    """rad: margin of the search space beyond start and goals."""
    stride: float
    """rad: longest edge of a tree."""
    checks: int
    """Collision checks after which the search gives up."""

    def path(self, edges: EdgeChecker, limits: JointLimits, start: Array, goals: Array) -> Array:
        """Return corners (m, dof) rad of a path from `start` (dof,) to one of `goals` (k, dof); (0, dof) if none."""
        util.RNG.setSeed(self.seed)
        dof, ends = len(start), np.vstack((start, goals))
        problem = OmplProblem(
            np.maximum(limits.lower, ends.min(axis=0) - self.detour),
            np.minimum(limits.upper, ends.max(axis=0) + self.detour),
            lambda a, b: edges.is_edge_free(np.array(a[0:dof]), np.array(b[0:dof])),
            start,
        )
        region = base.GoalStates(problem.information)
        for goal in goals:
            region.addState(problem.state(goal))
        planner = self.planner(problem.information)
        planner.setRange(self.stride)
        last = edges.checks + self.checks
        return problem.solve(planner, region, base.PlannerTerminationCondition(lambda: edges.checks >= last))
