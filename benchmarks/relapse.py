"""Check for slower code: processor times as ratios to references, measured in turns in one run.

    python benchmarks/relapse.py            # measure, and print a table
    python benchmarks/relapse.py --keep     # keep these ratios in benchmarks/relapse.csv
    python benchmarks/relapse.py --check    # fail if a ratio is more than 1.5 times the one kept, as CI does

References are what armctl is built on: EAIK alone, OSQP alone, raw `mj_step`; or Python's sort for what has no such
core (NumPy's uses the vector instructions that a processor has, and so is no reference for another machine).
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import gymnasium
import mujoco
import numpy as np
import pandas as pd
import typer
from printing import progress, show, versioned_table

from armctl.control.reach_mpc import ReachMpc, ReachMpcOptions
from armctl.kinematics import ArmModel, Ik, MinimumTimeReach, Workspace
from armctl.planning import ArmPlanner, plan_path
from armctl.shaping import Shaped
from armctl.tasks.bridge.layout import sample_layout as bridge_layout
from armctl.tasks.reach.obstacle_layout import sample_layout as reach_layout

KEPT = Path(__file__).with_suffix(".csv")
WORSE = 1.5
ROUNDS, SECONDS = 7, 0.3
"""Rounds of which each contender gets so many seconds of processor time."""
REACH, BRIDGE = "armctl/ArmReach-v0", "armctl/BridgeCross-v0"
WORLDS = 256

Work = Callable[[int], object]
"""Function that is timed; it is called with 0, 1, 2 ..."""


def sorting() -> Work:
    """Run a fixed piece of compiled code with many branches, of about a millisecond."""
    numbers = np.random.default_rng(0).random(5_000).tolist()
    return lambda i: sorted(numbers)


def inverse_kinematics() -> tuple[Work, Work]:
    """Compute all branches of a UR5, checked; EAIK alone."""
    model = ArmModel("ur5")
    ik, rng = Ik(model), np.random.default_rng(0)
    poses = [model.pose(q) for q in rng.uniform(-np.pi, np.pi, (256, model.dof))]
    assert ik.closed_form
    closed_form = ik.closed_form
    return lambda i: ik.pose(poses[i % 256]), lambda i: closed_form(poses[i % 256])


def reach_control() -> tuple[Work, Work]:
    """Make a decision of the arm's controller near its target; OSQP's solution of the same quadratic program."""
    model = ArmModel("ur5")
    mpc = ReachMpc(model, ReachMpcOptions())
    target, q = model.position(model.home) + 0.1, model.home
    mpc.plan(q, np.zeros(6), target, q)
    solver = mpc._constrained

    def solve(i: int) -> None:
        solver._osqp.warm_start(x=np.zeros(len(solver.qp.gradient)), y=solver.qp.first_duals())
        solver._osqp.solve(raise_error=False)

    return lambda i: mpc.plan(q, np.zeros(6), target, q), solve


def first_decision() -> tuple[Work, Work]:
    """Make the IK expert's plan for an episode."""
    model = ArmModel("ur5")
    search, workspace, rng = MinimumTimeReach(model), Workspace(model), np.random.default_rng(0)
    targets = [workspace.sample(rng, clearance=0.05) for _ in range(64)]
    return lambda i: search.find(model.home, targets[i % 64], 0.045), sorting()


def arm_plan() -> tuple[Work, Work]:
    """Plan a path of the arm around boxes."""
    model, rng = ArmModel("ur5"), np.random.default_rng(0)
    planner, workspace = ArmPlanner(model), Workspace(model)
    layouts = [reach_layout(rng, workspace, 0.05) for _ in range(16)]

    def plan(i: int) -> None:
        for layout in layouts:
            planner.plan(model.home, layout.target, 0.05, layout.boxes)

    return plan, sorting()


def bridge_plan() -> tuple[Work, Work]:
    """Plan a path over the bridge."""
    rng = np.random.default_rng(0)
    maps = [bridge_layout(rng, 20.0, 4.0, 7, 0, 1).map for _ in range(32)]
    return lambda i: plan_path(maps[i % 32], (1.0, 0.0), 19.0), sorting()


def stepped(env: str, num_envs: int | None, oracle: str | None = None) -> tuple[Work, Work]:
    """Make a control step of an environment; raw `mj_step` on as many worlds of its model, at rest."""
    plain: Any = gymnasium.make(env) if num_envs is None else gymnasium.make_vec(env, num_envs=num_envs, threads=1)
    playing: Any = plain if oracle is None else Shaped(plain, oracle, gamma=0.97)
    playing.reset(seed=0)
    playing.action_space.seed(0)
    actions = [playing.action_space.sample() for _ in range(50)]
    task = playing.unwrapped.task
    data = mujoco.MjData(task.simulation.model)
    mujoco.mj_resetDataKeyframe(task.simulation.model, data, 0)

    def step(i: int) -> None:
        _, _, terminated, truncated, _ = playing.step(actions[i % 50])
        if num_envs is None and (terminated or truncated):
            playing.reset()

    def raw(i: int) -> None:
        for _ in range(num_envs or 1):
            mujoco.mj_step(task.simulation.model, data, nstep=task.substeps)

    return step, raw


CASES: dict[str, Callable[[], tuple[Work, Work]]] = {
    "closed-form IK / EAIK": inverse_kinematics,
    "reach_mpc / OSQP": reach_control,
    "reach_ik plan / sort": first_decision,
    "16 arm plans / sort": arm_plan,
    "bridge plan / sort": bridge_plan,
    "reach, single / mj_step": lambda: stepped(REACH, None),
    "reach, batch / mj_step": lambda: stepped(REACH, WORLDS),
    "reach, shaped by ik / mj_step": lambda: stepped(REACH, WORLDS, "ik"),
    "bridge with camera / mj_step": lambda: stepped(BRIDGE, 64),
}


def measured(case: Callable[[], tuple[Work, Work]]) -> float:
    """Return the median ratio of the time of one call to that of its reference."""
    work, reference = case()
    for each in (work, reference):
        each(0)  # compiles
    return float(np.median([_seconds(work) / _seconds(reference) for _ in range(ROUNDS)]))


def min_ratio(case: Callable[[], tuple[Work, Work]], bound: float) -> float:
    """Return the least ratio of up to three measurements, since other work disturbs; one below `bound` suffices."""
    ratio = measured(case)
    for _ in range(2 if ratio > bound else 0):
        ratio = min(ratio, measured(case))
    return ratio


def _seconds(work: Work) -> float:
    """Return the time of one call, from groups of calls that grow: reading the clock takes 0.4 us."""
    calls, began = 0, time.process_time()
    while time.process_time() - began < SECONDS:
        group = range(calls, 9 * calls // 8 + 1)
        for i in group:
            work(i)
        calls = group.stop
    return (time.process_time() - began) / calls


def main(
    check: Annotated[bool, typer.Option("--check", help="Fail if something is 1.5 times as slow as kept.")] = False,
    keep: Annotated[bool, typer.Option("--keep", help="Keep what was measured.")] = False,
    only: Annotated[str, typer.Option(metavar="TEXT", help="Cases whose name contains this.")] = "",
) -> None:
    """Measure, and print a table."""
    kept = pd.read_csv(KEPT, index_col="case").ratio.to_dict() if KEPT.exists() else {}
    chosen = {name: case for name, case in CASES.items() if only in name}
    ratios = {
        name: min_ratio(case, WORSE * kept.get(name, np.inf)) for name, case in progress(chosen.items(), "timing")
    }
    table = versioned_table("", "now", "kept", "change")
    for name, ratio in ratios.items():
        kept_ratio = kept.get(name, np.nan)
        table.add_row(name, f"{ratio:.2f}", f"{kept_ratio:.2f}", f"{ratio / kept_ratio - 1:+.0%}")
    show(table)
    if keep:
        pd.Series(kept | ratios, name="ratio").round(3).rename_axis("case").to_csv(KEPT)
    regressions = [name for name, ratio in ratios.items() if ratio > WORSE * kept.get(name, np.inf)]
    if check and regressions:
        raise SystemExit(f"slower than {WORSE} times what was kept: {', '.join(regressions)}")


if __name__ == "__main__":
    typer.run(main)
