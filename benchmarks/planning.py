"""Time of planners over the bridge, excess of their paths over the shortest, and clearance from the blocks.

    python benchmarks/planning.py [--layouts 200] [--reference 20] [--seconds 5]

All planners meet the same random layouts of both environments, and check edges with the same code. The shortest path is
taken to be the best that any found, or a visibility graph over many points around each corner; BIT* has a long budget,
but for the first layouts only. Clearances are measured by shapely, which shares no code with armctl.
"""

import time
from collections.abc import Callable

import numpy as np
import shapely
import typer
from ompl import base, geometric, util
from printing import markdown_table, progress, show
from scipy.sparse.csgraph import dijkstra
from shapely import affinity

from armctl.core.arrays import Array
from armctl.planning import PathPlannerOptions, plan_path
from armctl.scene import BridgeMap
from armctl.tasks.bridge.layout import sample_layout

START, GOAL_X = (1.0, 0.0), 19.0
CLEARANCE = PathPlannerOptions().clearance
NO_PATH = np.zeros((0, 2))


def layouts(count: int) -> list[BridgeMap]:
    """Return maps of the static world, and of the moving one, in turn."""
    rng = np.random.default_rng(0)
    maps = [sample_layout(rng, 20.0, 4.0, *((7, 0) if i % 2 == 0 else (3, 3)), 1).map for i in range(count)]
    return [bridge.with_lanes_blocked() for bridge in maps]


class Edges(base.MotionValidator):
    """Edges by the exact test that armctl uses."""

    def __init__(self, information: base.SpaceInformation, bridge: BridgeMap) -> None:
        super().__init__(information)
        self.is_free = bridge.edge_test(CLEARANCE)

    def checkMotion(self, a: base.State, b: base.State) -> bool:  # noqa: D102, N802
        return self.is_free(a[0], a[1], b[0], b[1])


class Places(base.StateValidityChecker):
    """Places, as edges without length."""

    def __init__(self, information: base.SpaceInformation, edges: Edges) -> None:
        super().__init__(information)
        self.edges = edges

    def isValid(self, state: base.State) -> bool:  # noqa: D102, N802
        return self.edges.checkMotion(state, state)


def by_ompl(planner: str, seconds: float, simplify: bool = False) -> Callable[[BridgeMap], Array]:
    """Return a planner of OMPL as it comes, with a wall-clock budget."""

    def plan(bridge: BridgeMap) -> Array:
        def state(x: float, y: float) -> base.State:
            ompl_state = space.allocState()
            ompl_state[0], ompl_state[1] = x, y
            return ompl_state

        space, bounds = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
        side = bridge.half_width - CLEARANCE
        for axis, (low, high) in enumerate(((CLEARANCE, GOAL_X), (-side, side))):
            bounds.setLow(axis, low)
            bounds.setHigh(axis, high)
        space.setBounds(bounds)
        information = base.SpaceInformation(space)
        edges = Edges(information, bridge)
        places = Places(information, edges)
        information.setMotionValidator(edges)
        information.setStateValidityChecker(places)
        information.setup()
        problem = base.ProblemDefinition(information)
        problem.addStartState(state(*START))
        goals = base.GoalStates(information)
        for y in np.linspace(-side, side, 11).tolist():
            if edges.is_free(GOAL_X, y, GOAL_X, y):
                goals.addState(state(GOAL_X, y))
        problem.setGoal(goals)
        problem.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
        solver = getattr(geometric, planner)(information)
        solver.setProblemDefinition(problem)
        solver.setup()
        solver.solve(seconds)
        if not problem.hasExactSolution():
            return NO_PATH
        path = problem.getSolutionPath()
        if simplify:
            geometric.PathSimplifier(information).simplifyMax(path)
        return np.array([ompl_state[0:2] for ompl_state in path.getStates()])

    return plan


def by_armctl(options: PathPlannerOptions) -> Callable[[BridgeMap], Array]:
    return lambda bridge: plan_path(bridge, START, GOAL_X, options).path


def length(path: Array) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) if len(path) else np.inf


def shortest_length(bridge: BridgeMap) -> float:
    """Return the length by a visibility graph over points every 3 degrees around corners: at most 0.04 % too long."""
    turns = np.radians(np.arange(0, 360, 3))
    ring = (CLEARANCE + 1e-9) / np.cos(np.radians(1.5)) * np.column_stack((np.cos(turns), np.sin(turns)))
    points = np.vstack((START, (bridge.corners.reshape(-1, 1, 2) + ring).reshape(-1, 2)))
    points = points[bridge.clearance(points) >= CLEARANCE]
    at_goal = np.column_stack((np.full(len(points), GOAL_X), points[:, 1]))
    graph = np.zeros((len(points) + 1, len(points) + 1))
    i, j = np.triu_indices(len(points), k=1)
    free = bridge.segment_clearance(points[i], points[j]) >= CLEARANCE
    graph[i[free], j[free]] = np.linalg.norm(points[i] - points[j], axis=1)[free]
    graph[:-1, -1] = np.where(bridge.segment_clearance(points, at_goal) >= CLEARANCE, GOAL_X - points[:, 0], 0)
    return float(dijkstra(graph, directed=False, indices=[0])[0, -1])


def clearance(bridge: BridgeMap, path: Array) -> float:
    """Return the distance from a path to the nearest block or side, m, by shapely."""
    sides = shapely.box(0, -bridge.half_width, bridge.length, bridge.half_width).exterior
    boxes = [
        affinity.translate(affinity.rotate(shapely.box(-a, -b, a, b), yaw, origin=(0, 0), use_radians=True), x, y)
        for x, y, yaw, a, b in bridge.blocks
    ]
    return min(shapely.LineString(path).distance(shape) for shape in (sides, *boxes))


def main(count: int = typer.Option(200, "--layouts"), reference: int = 20, seconds: float = 5.0) -> None:
    """Measure, and print a table."""
    util.noOutputHandler()
    maps = layouts(count)
    patient = f"BIT*, {seconds:g} s"
    contenders = {
        "armctl: FMT* on chosen points": by_armctl(PathPlannerOptions()),
        "armctl, 100 points more": by_armctl(PathPlannerOptions(searches=(100,))),
        "RRT-Connect": by_ompl("RRTConnect", 1.0),
        "RRT-Connect, simplified": by_ompl("RRTConnect", 1.0, simplify=True),
        "BIT*, 20 ms": by_ompl("BITstar", 0.02),
        "informed RRT*, 100 ms": by_ompl("InformedRRTstar", 0.1),
        patient: by_ompl("BITstar", seconds),
    }
    paths: dict[str, list[Array]] = {name: [] for name in contenders}
    times: dict[str, list[float]] = {name: [] for name in contenders}
    for name, plan in contenders.items():
        plan(maps[0])  # compiles
        for bridge in progress(maps[: reference if name == patient else count], name):
            begin = time.perf_counter()
            paths[name].append(plan(bridge))
            times[name].append(1e3 * (time.perf_counter() - begin))
    best = np.array([shortest_length(bridge) for bridge in maps])
    for solutions in paths.values():
        best[: len(solutions)] = np.minimum(best[: len(solutions)], [length(path) for path in solutions])
    table = markdown_table(
        "", "found", "median ms", "99 %", "over the shortest: median", "most", "smallest clearance, m",
        title=f"{count} layouts, {reference} for {patient}; clearance {CLEARANCE} m",
    )  # fmt: skip
    for name in contenders:
        ratio = np.array([length(path) for path in paths[name]]) / best[: len(paths[name])]
        nearest = min(clearance(bridge, path) for bridge, path in zip(maps, paths[name], strict=False) if len(path))
        table.add_row(
            name, f"{np.mean([len(path) > 0 for path in paths[name]]):.1%}", f"{np.median(times[name]):,.1f}",
            f"{np.quantile(times[name], 0.99):.1f}", f"{np.median(ratio) - 1:.2%}",
            f"{ratio.max() - 1:.2%}" if np.isfinite(ratio).all() else "not found",
            f"{nearest:.4f}",
        )  # fmt: skip
    show(table, width=160)


if __name__ == "__main__":
    typer.run(main)
