"""How quickly paths over the bridge are found, how near to the shortest they are, and how near to the blocks.

    python benchmarks/planning.py [--layouts 200] [--reference 20] [--seconds 10]

All planners meet the same random layouts of both environments, check edges with the same code, and have their ways
pulled taut. The shortest path is taken to be the best of all that were found, among them those of BIT* with a long
budget, which only the first layouts get. Clearances are measured by shapely, which knows nothing of armctl's geometry.
"""

import numpy as np
import shapely
import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.progress import track
from rich.table import Table
from shapely import affinity

from armctl.planning import BridgeMap, PathPlannerOptions, PlanResult, plan_path
from armctl.tasks.bridge_layout import draw_layout

START, GOAL_X = (1.0, 0.0), 19.0
CONTENDERS = {
    "RRT-Connect, 3 ways (default)": PathPlannerOptions(),
    "RRT-Connect, 1 way": PathPlannerOptions(tries=1),
    "RRT-Connect, 10 ways": PathPlannerOptions(tries=10),
    "BIT*, 20 ms": PathPlannerOptions(planner="BITstar", seconds=0.02),
    "informed RRT*, 100 ms": PathPlannerOptions(planner="InformedRRTstar", seconds=0.1),
}


def layouts(count: int) -> list[BridgeMap]:
    """Maps of the static world, then of the moving one, alternating."""
    rng = np.random.default_rng(0)
    drawn = [draw_layout(rng, 20.0, 4.0, *((7, 0) if i % 2 == 0 else (3, 3)), 1).map for i in range(count)]
    return [bridge.with_lanes_blocked() for bridge in drawn]


def clearance(bridge: BridgeMap, result: PlanResult) -> float:
    """Distance from a path to the nearest block or side, m, by shapely."""
    path = shapely.LineString(result.path)
    sides = shapely.box(0, -bridge.half_width, bridge.length, bridge.half_width).exterior
    boxes = [
        affinity.translate(affinity.rotate(shapely.box(-a, -b, a, b), yaw, origin=(0, 0), use_radians=True), x, y)
        for x, y, yaw, a, b in bridge.blocks
    ]
    return min(path.distance(shape) for shape in (sides, *boxes))


def main(count: int = typer.Option(200, "--layouts"), reference: int = 20, seconds: float = 10.0) -> None:
    """Measure, and print a table."""
    maps = layouts(count)
    plan_path(maps[0], START, GOAL_X)  # loads OMPL
    bar = Console(stderr=True)
    results = {
        name: [plan_path(bridge, START, GOAL_X, options) for bridge in track(maps, name, console=bar, transient=True)]
        for name, options in CONTENDERS.items()
    }
    patient = PathPlannerOptions(planner="BITstar", seconds=seconds)
    long = [
        plan_path(bridge, START, GOAL_X, patient)
        for bridge in track(maps[:reference], f"BIT*, {seconds:g} s", console=bar, transient=True)
    ]
    best = np.array([min(many[i].length for many in (long, *results.values())) for i in range(reference)])
    table = Table(
        "", "found", "ms", "99 %", "over the shortest", "at most", "clearance, m",
        title=f"{count} layouts; the shortest of {reference} is known; clearance {PathPlannerOptions().clearance} m",
        title_justify="left", box=SIMPLE,
    )  # fmt: skip
    for name, plans in (*results.items(), (f"BIT*, {seconds:g} s", long)):
        milliseconds = 1e3 * np.array([plan.seconds for plan in plans])
        ratio = np.array([plan.length for plan in plans[:reference]]) / best
        nearest = min(clearance(bridge, plan) for bridge, plan in zip(maps, plans, strict=False) if plan.found)
        table.add_row(
            name, f"{np.mean([plan.found for plan in plans]):.1%}", f"{np.median(milliseconds):.1f}",
            f"{np.quantile(milliseconds, 0.99):.1f}", f"{np.median(ratio) - 1:.2%}", f"{ratio.max() - 1:.2%}",
            f"{nearest:.4f}",
        )  # fmt: skip
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
