"""Success rate, time and quality of planners that find ways around boxes for an arm.

    python benchmarks/arm_planning.py [--layouts 500] [--robot ur5]

All planners meet the same random layouts, from home to a sphere around the target, and check motions with one code.
OMPL's own planners get the arm's configurations at the target as goals. A path is valid if the arm's capsules touch
nothing in steps of 0.01 rad along it. Lengths are seconds at the joints' velocity limits, before and after shortening.
(PRM is not among them: it waits for a thread of its own, which waits for Python.)
"""

import itertools
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import typer
from ompl import base, geometric, util
from printing import markdown_table, progress, show

from armctl.core.arrays import Array
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker, Ik, Workspace
from armctl.planning import ArmPlanner, ArmPlannerOptions
from armctl.tasks.reach.obstacle_layout import ReachLayout, sample_layout

Planner = Callable[[ReachLayout], tuple[float, Array]]
"""Function of a layout: the length of a path before shortening, and the path; it is empty for a failure."""

TOLERANCE = 0.05
"""m, radius of the sphere."""
STEP = 0.01
"""rad between the configurations at which a path is tested."""
GOALS = 32


class Motions(base.MotionValidator):
    """Motions by the test that armctl uses."""

    def __init__(self, information: base.SpaceInformation, motions: EdgeChecker, dof: int) -> None:
        super().__init__(information)
        self.motions, self.dof = motions, dof

    def checkMotion(self, a: base.State, b: base.State) -> bool:  # noqa: D102, N802
        return self.motions.is_edge_free(np.array(a[0 : self.dof]), np.array(b[0 : self.dof]))


class Configurations(base.StateValidityChecker):
    """Configurations likewise."""

    def __init__(self, information: base.SpaceInformation, motions: EdgeChecker, dof: int) -> None:
        super().__init__(information)
        self.motions, self.dof = motions, dof

    def isValid(self, state: base.State) -> bool:  # noqa: D102, N802
        return self.motions.is_free(np.array(state[0 : self.dof]))


def by_armctl(model: ArmModel) -> Planner:
    planner = ArmPlanner(model)

    def plan(layout: ReachLayout) -> tuple[float, Array]:
        result = planner.plan(model.home, layout.target, TOLERANCE, layout.boxes)
        return result.raw_time, result.path

    return plan


def by_ompl(model: ArmModel, planner: str, seconds: float) -> Planner:
    """Return a planner of OMPL as it comes, and OMPL's shortening; it has so many seconds."""
    ik, shapes = Ik(model), ArmShapes(model)
    low, high = np.maximum(model.limits.lower, -np.pi), np.minimum(model.limits.upper, np.pi)

    def plan(layout: ReachLayout) -> tuple[float, Array]:
        def state(q: Array) -> Any:
            ompl_state = space.allocState()
            for joint, angle in enumerate(q.tolist()):
                ompl_state[joint] = angle
            return ompl_state

        motions = EdgeChecker(shapes, layout.boxes, ArmPlannerOptions().clearance, model.home)
        space, bounds = base.RealVectorStateSpace(model.dof), base.RealVectorBounds(model.dof)
        for joint in range(model.dof):
            bounds.setLow(joint, low[joint])
            bounds.setHigh(joint, high[joint])
        space.setBounds(bounds)
        information = base.SpaceInformation(space)
        validator, checker = Motions(information, motions, model.dof), Configurations(information, motions, model.dof)
        information.setMotionValidator(validator)
        information.setStateValidityChecker(checker)
        information.setup()
        problem = base.ProblemDefinition(information)
        problem.addStartState(state(model.home))
        goals = base.GoalStates(information)
        free = (q for q in ik.free_configurations(layout.target) if (abs(q) <= high).all() and motions.is_free(q))
        for goal in itertools.islice(free, GOALS):
            goals.addState(state(goal))
        if not goals.hasStates():
            return np.inf, np.zeros((0, model.dof))
        problem.setGoal(goals)
        solver = getattr(geometric, planner)(information)
        solver.setProblemDefinition(problem)
        solver.setup()
        solver.solve(seconds)
        if not problem.hasExactSolution():
            return np.inf, np.zeros((0, model.dof))
        path = problem.getSolutionPath()
        raw = length(model, np.array([ompl_state[0 : model.dof] for ompl_state in path.getStates()]))
        geometric.PathSimplifier(information).simplifyMax(path)
        return raw, np.array([ompl_state[0 : model.dof] for ompl_state in path.getStates()])

    return plan


def is_valid(model: ArmModel, layout: ReachLayout, path: Array) -> bool:
    """Return True if a path starts at home, ends in the sphere, and touches nothing."""
    among = model.among(layout.boxes)
    ends = np.array_equal(path[0], model.home) and np.linalg.norm(model.position(path[-1]) - layout.target) <= TOLERANCE
    steps = (np.linspace(a, b, 1 + int(np.abs(b - a).max() / STEP)) for a, b in itertools.pairwise(path))
    return bool(ends) and all(among.is_free(q) for q in itertools.chain(path, *steps))


def length(model: ArmModel, path: Array) -> float:
    return float(model.cruise_time(path[:-1], path[1:]).sum())


def main(count: int = typer.Option(500, "--layouts"), robot: str = "ur5") -> None:
    """Measure, and print a table."""
    util.noOutputHandler()
    model, rng = ArmModel(robot), np.random.default_rng(0)
    workspace = Workspace(model)
    begin = time.perf_counter()
    layouts = [sample_layout(rng, workspace, TOLERANCE) for _ in range(count)]
    drawing = 1e3 * (time.perf_counter() - begin) / count
    contenders = {
        "armctl": by_armctl(model),
        "RRT-Connect": by_ompl(model, "RRTConnect", 1.0),
        "LBKPIECE": by_ompl(model, "LBKPIECE1", 1.0),
        "BIT*, 0.2 s": by_ompl(model, "BITstar", 0.2),
    }
    table = markdown_table(
        "", "solved", "valid", "total", "mean ms", "50 %", "95 %", "99 %", "most", "raw s", "shortened s",
        title=f"{count} layouts, {robot}, drawn in {drawing:.1f} ms each",
    )  # fmt: skip
    for name, plan in contenders.items():
        plan(layouts[0])  # compiles
        times, raws, shorts, valid = [], [], [], 0
        for layout in progress(layouts, name):
            begin = time.perf_counter()
            raw, short = plan(layout)
            times.append(1e3 * (time.perf_counter() - begin))
            if len(short):
                raws.append(raw)
                shorts.append(length(model, short))
                valid += is_valid(model, layout, short)
        quantiles = np.quantile(times, (0.5, 0.95, 0.99, 1))
        table.add_row(
            name, str(len(shorts)), str(valid), str(count), *(f"{ms:.1f}" for ms in (np.mean(times), *quantiles)),
            f"{np.mean(raws):.2f}", f"{np.mean(shorts):.2f}",
        )  # fmt: skip
    show(table, width=160)


if __name__ == "__main__":
    typer.run(main)
