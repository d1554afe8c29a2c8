"""The experts on MotionBenchMaker's problems for an arm, executed with dynamics, and the time that planning takes.

    python benchmarks/motion_bench_maker.py [--robot panda_open] [--policies reach_ompl,reach_mpc] [--scenes box,cage]

Each policy plays all solvable problems of each scene once, in the order of the seed. Planning is `ArmPlanner` from the
start to the target's pose with the options of `reach_ompl`: nearer to things after each failure, at most `PLANS` times,
all failures, goals and shortcuts included. Published figures are from another machine, for another model of the robot.
"""

from collections.abc import Iterator

import numpy as np
import typer
from printing import markdown_table, progress, show

import armctl
from armctl.baselines.reach_ompl import GOALS
from armctl.baselines.reach_task import planning
from armctl.kinematics import ArmModel, MinimumTimePose
from armctl.planning import ArmPlanner, ArmPlannerOptions
from armctl.tasks import ReachScenesOptions
from armctl.tasks.reach import read_boxes
from armctl.tasks.reach.motion_bench_maker import ROBOTS, scene_names, shipped_problems

ENV = "armctl/ArmScenes-v0"
WORLDS, PLANS = 10, 6
POLICIES = "reach_ompl,reach_mpc,reach_ik"
PUBLISHED = {
    "ur5_robotiq85": "median 0.11 ms, 95th percentile 0.84 ms; 608 of 608 valid problems solved, of 700",
    "panda_open": "median 0.10 ms, 95th percentile 0.44 ms; 699 of 699 valid problems solved, of 700",
}
"""VAMP, resources/README.md at f6de6a7: RRT-Connect with simplification, to goals in joint positions, on an AMD Ryzen 9
7950X."""


def main(policies: str = POLICIES, seed: int = 311, scenes: str = "all", robot: str = ROBOTS[0]) -> None:
    """Play the same problems with each policy, plan them, and print a table."""
    names, problems = policies.split(","), shipped_problems(robot)
    table = markdown_table("scene", "solvable", *(f"`{name}`" for name in names), "planned", "ms: median", "p95")
    wins, solvable, plans = np.zeros(len(names), dtype=int), 0, []
    for scene in scene_names(scenes):
        rows = problems.rows(scene, "all", solvable=True)
        options = {"scenes": scene, "robot": robot}
        comparison = armctl.compare(names, ENV, episodes=len(rows), seed=seed, worlds=WORLDS, env_options=options)
        success = comparison.episodes.groupby("policy").success.sum()
        won = np.array([success[name] for name in names])
        planned = list(planned_paths(robot, rows))
        table.add_row(scene, f"{len(rows)} of 100", *(f"{n}" for n in won), *times(planned))
        wins, solvable, plans = wins + won, solvable + len(rows), plans + planned
    shares = (f"{n} ({n / solvable:.1%})" for n in wins)
    table.add_row("all", f"{solvable} of {100 * len(scene_names(scenes))}", *shares, *times(plans))
    show(table, width=200)
    print(f"\narmctl {armctl.__version__}, seed {seed}. Published of VAMP's RRT-Connect: {PUBLISHED[robot]}.")


def planned_paths(robot: str, rows: np.ndarray) -> Iterator[tuple[bool, float]]:
    """Plan each of some problems, and yield whether there is a path, and the time, s."""
    problems, model, task = shipped_problems(robot), ArmModel(robot), ReachScenesOptions()
    search = MinimumTimePose(model, task.lever)
    clearances, effort = planning(task)
    planners = [
        ArmPlanner(model, ArmPlannerOptions(clearance=clearance, goals=GOALS * seed, seed=seed, **effort), search)
        for seed, clearance in zip(range(1, PLANS + 1), (*clearances, *[clearances[-1]] * PLANS), strict=False)
    ]
    for row in progress(rows, "plans"):
        start, place = problems.starts[row].astype(float), search.place(problems.goals[row].astype(float))
        boxes = read_boxes(problems.boxes[row], task.box_numbers)
        seconds = 0.0
        for planner in planners:
            plan = planner.plan(start, place, task.tolerance, boxes)
            seconds += plan.seconds
            if plan.solved:
                break
        yield plan.solved, seconds


def times(plans: list[tuple[bool, float]]) -> tuple[str, str, str]:
    """Return for how many problems there is a path, and the median and 95th percentile of the time of all, ms."""
    median, slow = np.percentile([1e3 * seconds for _, seconds in plans], (50, 95))
    return f"{sum(solved for solved, _ in plans)}", f"{median:.1f}", f"{slow:.1f}"


if __name__ == "__main__":
    typer.run(main)
