"""Standard arenas: classical policies against agents by RL Zoo's settings, in tasks of others with published numbers.

    python benchmarks/arenas.py reacher|pusher|fetch-reach|fetch-push|panda-reach|panda-push
        [--episodes 100] [--seed 300] [--trainings 1] [--steps N] [--folder arenas]

A command makes the virtual environment that its task needs, trains SAC there, converts it into agents of armctl's, and
plays all policies in the same episodes here. What a folder has by now, is not made again. Environments of
Gymnasium-Robotics and panda-gym run in a process of their own; experts and the training are in `examples/arenas/`. No
agent is trained for the two pushes with goals, for which RL Zoo takes 1,000,000 control steps.
"""

import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import typer
from other_processes import interpreter
from printing import markdown_table, show

import armctl
from armctl.core.errors import unknown_name
from armctl.stats.intervals import Estimate
from armctl.study import compare
from armctl.study.comparison import Comparison
from armctl.training.learners import ModelExport, load_exporter
from armctl.verdict.tables import milliseconds

EXAMPLES = Path(__file__).parents[1] / "examples" / "arenas"
TRAINING = ("stable-baselines3==2.9.2", "torch==2.13.0")
FETCH = ("gymnasium-robotics==1.4.2", "mujoco==3.3.7", *TRAINING)
PANDA = ("panda-gym==3.0.7", "pybullet==3.2.7", *TRAINING)
SECONDS = 60.0
"""Time limit of a call."""


@dataclass(frozen=True)
class Arena:
    """A task of others, and its policies."""

    env: str
    """Id, with its module if Gymnasium does not know it."""
    experts: dict[str, str]
    """Classical policies by name: one of armctl's, or `FILE:CLASS` in `examples/arenas/`."""
    steps: int = 0
    """Control steps of a training; 0: none."""
    packages: tuple[str, ...] = field(default=())
    """Packages of a virtual environment in which the task runs; none: it runs here."""


GYMNASIUM, GOALS = "torque_arms.py", "goal_experts.py"
ARENAS = {
    "reacher": Arena("Reacher-v5", {"ik_lqr": f"{GYMNASIUM}:Reacher", "mppi": "mppi"}, 50_000),
    "pusher": Arena("Pusher-v5", {"torque": f"{GYMNASIUM}:Pusher", "mppi": "mppi"}, 50_000),
    "fetch-reach": Arena("gymnasium_robotics:FetchReach-v4", {"straight": f"{GOALS}:Reach"}, 20_000, FETCH),
    "fetch-push": Arena("gymnasium_robotics:FetchPush-v4", {"scripted": f"{GOALS}:FetchPush"}, 0, FETCH),
    "panda-reach": Arena("panda_gym:PandaReach-v3", {"straight": f"{GOALS}:Reach"}, 20_000, PANDA),
    "panda-push": Arena("panda_gym:PandaPush-v3", {"scripted": f"{GOALS}:PandaPush"}, 0, PANDA),
}


def main(
    name: Annotated[str, typer.Argument(metavar="|".join(ARENAS))],
    episodes: Annotated[int, typer.Option(min=1)] = 100,
    seed: int = 300,
    trainings: Annotated[int, typer.Option(min=0, help="Number of training seeds; 0: no agent plays.")] = 1,
    steps: Annotated[int | None, typer.Option(min=1, help="Control steps of a training.")] = None,
    folder: Path = Path("arenas"),
) -> None:
    """Play the policies of an arena in the same episodes, and print table and verdict."""
    if name not in ARENAS:
        raise typer.BadParameter(str(unknown_name("arena", name, ARENAS)))
    arena, folder = ARENAS[name], folder.resolve()
    packages = arena.packages and interpreter(folder / arena.env.partition(":")[0], arena.packages)
    python = packages or Path(sys.executable)
    env = f"python={python}:{arena.env}" if arena.packages else arena.env
    policies: dict[str, Any] = {
        label: str(EXAMPLES / policy) if ":" in policy else policy for label, policy in arena.experts.items()
    }
    if arena.steps and trainings:
        recipe = folder / f"{name}-sac"
        for number in range(trainings):
            trained(python, arena.env, env, Path(f"{recipe}-{number}"), steps or arena.steps)
        policies["sac"] = f"{recipe}[*]"
    policies["random"] = "random"
    print_result(compare(policies, env, episodes=episodes, seed=seed, timeout=SECONDS))


def trained(python: Path, name: str, env: str, home: Path, steps: int) -> None:
    """Train SAC by a Python in a folder `RECIPE-SEED`, and make an agent of it, unless it is there."""
    if (home / "agent.json").exists():
        return
    if not (home / "model.zip").exists():
        seed = home.name.rpartition("-")[2]
        code = EXAMPLES / "zoo_sac.py"
        subprocess.run([python, code, name, home, f"--steps={steps}", f"--seed={seed}"], check=True, stdout=sys.stderr)
    model = home / "model.zip"
    load_exporter(model)(ModelExport(model, env, home / "agent.onnx", trust=True))


def print_result(result: Comparison) -> None:
    """Print a row for each policy, and the verdict."""
    table = markdown_table("policy", "success %", "return", "median return", "control steps", "decision")
    for policy in result.policies:
        returns = result.counted[policy.policy].column("total_reward")
        table.add_row(
            policy.policy,
            "-" if policy.success is None else with_interval(policy.success, 100, ".0f"),
            f"{returns.mean():.2f} ± {returns.std():.2f}",
            "-" if policy.median_return is None else with_interval(policy.median_return, 1, ".2f"),
            f"{policy.length.value:.1f}" if policy.length else "-",
            milliseconds(policy.decision_ms_p50),
        )
    show(table)
    print(result.verdict)
    print(f"{result.policies[0].episodes} episodes of seed {result.seed}, armctl {armctl.__version__}")


def with_interval(estimate: Estimate, factor: float, digits: str) -> str:
    """Return an estimate in words, with its interval if it has one."""
    value, *ends = (
        f"{factor * number:{digits}}" for number in (estimate.value, estimate.low, estimate.high) if number is not None
    )
    return f"{value} ({' to '.join(ends)})" if len(ends) > 1 else value


if __name__ == "__main__":
    typer.run(main)
