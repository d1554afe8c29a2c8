"""Judgements of layouts among obstacles by the certificate of feasibility and by the expert's own planner.

    python benchmarks/feasibility.py [--layouts 500] [--robot ur5]

Both meet the same random layouts. What one solves and the other does not tells how much a set of certified episodes
would favour `reach_ompl` if its own planner were the judge.
"""

import time

import numpy as np
import typer

from armctl.kinematics import ArmModel, Workspace
from armctl.planning import ArmPlanner, PathCertificate
from armctl.tasks.reach.obstacle_layout import sample_layout

TOLERANCE = 0.05
"""m, radius of the sphere."""


def main(layouts: int = 500, robot: str = "ur5") -> None:
    """Judge, and print counts and times."""
    model, rng = ArmModel(robot), np.random.default_rng(0)
    workspace, certificate, planner = Workspace(model), PathCertificate(model), ArmPlanner(model)
    judges = {
        "certificate": lambda layout: len(certificate.path(model.home, layout.target, layout.boxes)) > 0,
        "planner": lambda layout: planner.plan(model.home, layout.target, TOLERANCE, layout.boxes).solved,
    }
    samples = [sample_layout(rng, workspace, TOLERANCE) for _ in range(layouts)]
    solved, milliseconds = {}, {}
    for name, judge in judges.items():
        solved[name], milliseconds[name] = np.zeros(layouts, bool), np.zeros(layouts)
        for i, layout in enumerate(samples):
            begin = time.perf_counter()
            solved[name][i] = judge(layout)
            milliseconds[name][i] = 1e3 * (time.perf_counter() - begin)
        times = ", ".join(f"{ms:.1f}" for ms in (milliseconds[name].mean(), *np.quantile(milliseconds[name], (0.5, 1))))
        print(f"{name}: {solved[name].sum()} of {layouts} solved; mean, median, most ms: {times}")
    a, b = solved["certificate"], solved["planner"]
    print(f"certificate only: {(a & ~b).sum()}; planner only: {(b & ~a).sum()}; neither: {(~a & ~b).sum()}")


if __name__ == "__main__":
    typer.run(main)
