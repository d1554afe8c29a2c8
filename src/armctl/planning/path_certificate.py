"""Certifies that an arm has a way around boxes, independently of `ArmPlanner`, whose paths policies follow.

LBKPIECE (Sucan and Kavraki, "Kinodynamic motion planning by interior-exterior cell exploration", WAFR 2008; lazy and
bidirectional) searches with another seed, other goals, half the clearance and five times the budget. The budget is a
number of collision checks, never a time: a label is the same on every machine.
"""

import itertools
from collections.abc import Iterable
from typing import Annotated

import numpy as np
from ompl import geometric
from pydantic import Field

from armctl.core.arrays import Array
from armctl.core.options import Count, Positive, options
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker, Ik
from armctl.kinematics.edge_checker import MAX_CLEARANCE
from armctl.planning.arm_search import ArmSearch
from armctl.scene import Boxes

SEED = 2
"""Random seed of each search: not the one of `ArmPlanner`."""
DETOUR = np.pi
"""rad: margin of the search space beyond start and goals."""


@options
class PathCertificateOptions:
    """Options of a `PathCertificate`."""

    clearance: Annotated[float, Field(gt=0, le=MAX_CLEARANCE)] = 0.005
    """m: distance from boxes, floor and the arm itself along the whole path."""
    goals: Count = 64
    """Number of configurations at the target from which the search starts."""
    checks: Annotated[int, Field(ge=0)] = 30_000
    """Collision checks after which the search gives up."""
    stride: Positive = 1.0
    """rad: longest edge of a tree."""


class PathCertificate:
    """Certifies layouts for one arm. Not thread-safe."""

    def __init__(self, model: ArmModel, options: PathCertificateOptions | None = None) -> None:
        self.model, self.options = model, options or PathCertificateOptions()
        self._ik, self._shapes = Ik(model), ArmShapes(model)

    def path(self, start: Array, target: Array, boxes: Boxes) -> Array:
        """Return corners (m, dof) rad from `start` (dof,) to a configuration with the end-effector at `target` (3,), m.

        (0, dof) if none was found within the budget. The same arguments give the same path.
        """
        return self.path_to(self._ik.free_configurations(target), start, boxes)

    def path_to(self, configurations: Iterable[Array], start: Array, boxes: Boxes) -> Array:
        """Return the same to one of `configurations` (dof,), the first of which are tried."""
        edges = EdgeChecker(self._shapes, boxes, self.options.clearance, start)
        free = filter(edges.is_free, configurations)
        goals = list(itertools.islice(free, self.options.goals))
        if not goals or not edges.start_is_free:
            return np.zeros((0, self.model.dof))
        options = self.options
        search = ArmSearch(geometric.LBKPIECE1, SEED, DETOUR, options.stride, options.checks)
        return search.path(edges, self.model.limits, start, np.array(goals))
