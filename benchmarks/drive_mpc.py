"""Decision time of the rover's model-predictive controller on bridges, and distance of its plans from the best.

    python benchmarks/drive_mpc.py [--episodes 12] [--repeats 3]

`bridge_mpc` plays, and then new controllers decide on the same situations again. Times are processor time, the least of
several runs. Each 20th plan is held against the same problem solved to convergence from it on, by IPOPT. A metre of
progress, in one of the steps, is worth 1.
"""

import time
from dataclasses import dataclass
from typing import Any

import casadi
import gymnasium
import numpy as np
import typer
from printing import markdown_table, progress, show

from armctl.baselines import bridge_mpc
from armctl.control.drive_mpc import DriveMpc, DriveMpcResult
from armctl.control.drive_nlp import CONTROLS, DriveSolver, drive_nlp
from armctl.policies import make_policy

ENVIRONMENTS = "armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0"
MAX_STEPS = 200
SEED = 31
EACH = 20


@dataclass
class Drive:
    """Options of one controller, and its decisions: poses, velocities and people."""

    made_of: tuple[Any, ...]
    situations: list[tuple[Any, ...]]


def recorded_drives(env_id: str, episodes: int) -> list[Drive]:
    drives: list[Drive] = []

    class Recorder(DriveMpc):
        def __init__(self, *made_of: Any) -> None:
            super().__init__(*made_of)
            self.drive = Drive(made_of, [])
            drives.append(self.drive)

        def decide(self, *situation: Any) -> DriveMpcResult:
            self.drive.situations.append(tuple(np.array(part) for part in situation))
            return super().decide(*situation)

    bridge_mpc.DriveMpc = Recorder
    env: Any = gymnasium.make_vec(env_id, num_envs=episodes, autoreset_mode="disabled", observation="state")
    policy = make_policy("bridge_mpc", env)
    observations, _ = env.reset(seed=SEED)
    policy.reset(np.arange(episodes, dtype=np.int32))
    over = np.zeros(episodes, dtype=bool)
    for _ in progress(range(MAX_STEPS), env_id):
        observations, _, terminated, truncated, _ = env.step(policy.act(observations))
        over |= terminated | truncated
        for world in np.flatnonzero(over):
            policy._controllers[world] = None  # type: ignore[attr-defined]  # it would drive on
        if over.all():
            break
    env.close()
    return drives


def replayed(drives: list[Drive]) -> tuple[list[float], list[DriveMpcResult]]:
    """Return the processor time of each decision, s, and its result."""
    seconds, results = [], []
    for drive in drives:
        mpc = DriveMpc(*drive.made_of)
        for situation in drive.situations:
            began = time.process_time()
            results.append(mpc.decide(*situation))
            seconds.append(time.process_time() - began)
    return seconds, results


def excess(drives: list[Drive]) -> tuple[float, list[float]]:
    """Return solutions per decision, and by how much each 20th costs more than the local optimum near it."""
    solved, solve = [], DriveSolver.solve

    def recorded(solver: DriveSolver) -> Any:
        solved.append((solver.parameters.copy(), solve(solver)))
        return solved[-1][1]

    DriveSolver.solve = recorded  # type: ignore[assignment]
    try:
        decisions = len(replayed(drives)[0])
    finally:
        DriveSolver.solve = solve
    nlp = drive_nlp(drives[0].made_of[2])
    quiet: Any = {"ipopt.print_level": 0, "ipopt.tol": 1e-9, "print_time": False, "ipopt.sb": "yes"}
    reference, over = casadi.nlpsol("reference", "ipopt", nlp.problem, quiet), []
    for parameters, plan in solved[::EACH]:
        if plan.solved:
            best = reference(x0=plan.knots.ravel()[:-CONTROLS], p=parameters, **nlp.bounds)
            over.append(plan.cost - float(best["f"]))
    return len(solved) / decisions, over


def main(episodes: int = 12, repeats: int = 3) -> None:
    """Measure, and print a table."""
    table = markdown_table(
        "environment", "decisions", "ms", "99 %", "most", "iterations", "99 %", "plans a decision", "failures",
        "cost over the best", "99 %",
    )  # fmt: skip
    for env_id in ENVIRONMENTS:
        drives = recorded_drives(env_id, episodes)
        runs = [replayed(drives) for _ in range(repeats)]
        milliseconds, results = 1e3 * np.min([seconds for seconds, _ in runs], axis=0), runs[0][1]
        iterations = [result.iterations for result in results]
        plans, over = excess(drives)
        table.add_row(
            env_id, str(len(milliseconds)), *(f"{np.quantile(milliseconds, share):.2f}" for share in (0.5, 0.99, 1.0)),
            *(f"{np.quantile(iterations, share):.0f}" for share in (0.5, 0.99)), f"{plans:.2f}",
            str(sum(not result.solved for result in results)),
            *(f"{np.quantile(over, share):.4f}" for share in (0.5, 0.99)),
        )  # fmt: skip
    show(table, width=160)


if __name__ == "__main__":
    typer.run(main)
