"""OMPL's set-up for planning in a box of R^n, where validity is a property of edges alone."""

from collections.abc import Callable
from typing import Any

import numpy as np
from ompl import base, util

from armctl.core.arrays import Array

util.noOutputHandler()  # results report failures


class OmplProblem:
    """Query from `start` (n,), in the box from `low` to `high`, (n,) each.

    `is_edge_free` takes two OMPL states and checks the straight edge between them, both ends included.
    """

    def __init__(self, low: Array, high: Array, is_edge_free: Callable[[Any, Any], bool], start: Array) -> None:
        self._dimension = len(low)
        self._space = base.RealVectorStateSpace(self._dimension)
        bounds = base.RealVectorBounds(self._dimension)
        for i in range(self._dimension):
            bounds.setLow(i, float(low[i]))
            bounds.setHigh(i, float(high[i]))
        self._space.setBounds(bounds)
        self.information = base.SpaceInformation(self._space)
        self._validator = _EdgeValidator(self.information, is_edge_free)
        self.information.setMotionValidator(self._validator)
        self.information.setStateValidityChecker(base.AllValidStateValidityChecker(self.information))
        self.information.setup()
        self._definition = base.ProblemDefinition(self.information)
        self._definition.addStartState(self.state(start))

    @property
    def edges_checked(self) -> int:
        """Number of edges that the planner has checked."""
        return self._validator.checked

    def state(self, values: Array) -> Any:
        """Return OMPL's state for coordinates (n,)."""
        state = self._space.allocState()
        for i, value in enumerate(values.tolist()):
            state[i] = value
        return state

    def solve(self, planner: Any, goal: Any, termination: Any) -> Array:
        """Return corners (m, n) of the path that `planner` finds; (0, n) if it finds no exact solution."""
        self._definition.setGoal(goal)
        planner.setProblemDefinition(self._definition)
        planner.setup()
        planner.solve(termination)
        if not self._definition.hasExactSolution():
            return np.zeros((0, self._dimension))
        return np.array([state[0 : self._dimension] for state in self._definition.getSolutionPath().getStates()])


class _EdgeValidator(base.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: Any, is_edge_free: Callable[[Any, Any], bool]) -> None:
        super().__init__(information)
        self._is_edge_free, self.checked = is_edge_free, 0

    def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802
        self.checked += 1
        return self._is_edge_free(a, b)
