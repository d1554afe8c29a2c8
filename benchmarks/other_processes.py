"""Tasks of others: classical policies against agents that are trained here.

    python benchmarks/other_processes.py gymnasium [--episodes 50] [--seed 300] [--folder other_processes]
    python benchmarks/other_processes.py goals
    python benchmarks/other_processes.py metaworld
    python benchmarks/other_processes.py safe-control [--source git+https://...]

Packages that cannot stand beside armctl are in a virtual environment of their own, made here. `gymnasium` trains a SAC
agent for `Reacher-v5` and for `Pusher-v5`, and compares it with `mppi`; `goals` one for reach and push of Fetch and
Panda, and compares it with a scripted expert: an hour of one core each. `metaworld` does so in Meta-World's reach and
push: minutes. `safe-control` compares the LQR and the MPC of safe-control-gym,
which is no package of an index: `--source` is what pip installs, such as a clone's folder. What a folder has by now, is
not made again. Environments and policies are in `examples/other_processes/`.
"""

import contextlib
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import typer
from printing import markdown_table, show

import armctl
from armctl.study import compare
from armctl.verdict.summary import PolicySummary

EXAMPLES = Path(__file__).parents[1] / "examples" / "other_processes"
METAWORLD = ("metaworld==3.1.1", "packaging", "scipy", "stable-baselines3==2.9.2", "torch==2.13.0")
SAFE_CONTROL = (
    *("pybullet==3.2.7", "numpy", "scipy", "casadi==3.8.2", "munch", "pyyaml", "dict-deep", "gymnasium==0.28.1"),
    *("termcolor", "matplotlib", "imageio", "torch==2.13.0"),
)
"""Packages that the quadrotor, LQR and MPC import, of those that safe-control-gym requires."""
SOURCE = "git+https://github.com/utiasDSL/safe-control-gym@e39a5692a2989567b922f3033e50b49242896864"
TASKS = {"reach": "reach-v3", "push": "push-v3"}
GYMNASIUM = {"Reacher-v5": 100_000, "Pusher-v5": 100_000}
"""Control steps of a training in each."""
GOALS = {
    "Fetch": ("gymnasium-robotics==1.4.2", "mujoco==3.3.7"),
    "Panda": ("panda-gym==3.0.7", "pybullet==3.2.7"),
}
"""Packages of each robot's tasks, besides those that train."""
SECONDS = 60.0
"""Time limit of a call."""

app = typer.Typer(add_completion=False, help=__doc__)
Episodes = Annotated[int, typer.Option(min=1)]
Folder = Annotated[Path, typer.Option()]


@app.command()
def metaworld(episodes: Episodes = 50, seed: int = 300, folder: Folder = Path("other_processes")) -> None:
    """Compare scripted experts with agents of Stable-Baselines3 in Meta-World's reach and push."""
    python, code = interpreter(folder / "metaworld", METAWORLD), EXAMPLES / "metaworld_sawyer.py"
    rows = []
    for task, name in TASKS.items():
        if not (folder / f"{name}.zip").exists():
            subprocess.run([python, code, name], cwd=folder, check=True, stdout=sys.stderr)
        policies = {"scripted expert": f"{task.title()}Expert", "SAC": f"{task.title()}Agent"}
        result = comparison(python, code, task, policies, episodes, seed, folder, {"success": "any"})
        rows += [(f"Meta-World {task}", policy) for policy in result.policies]
    print_rows(rows, episodes, seed)


@app.command()
def gymnasium(episodes: Episodes = 50, seed: int = 300, folder: Folder = Path("other_processes")) -> None:
    """Compare mppi with agents of Stable-Baselines3 in tasks of Gymnasium."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for env, steps in GYMNASIUM.items():
        agent = folder / f"{env}.zip"
        if not agent.exists():
            _train_sac(env, steps, agent)
        result = compare({"MPPI": "mppi", "SAC": agent}, env, episodes=episodes, seed=seed, worlds=10)
        rows += [(env, policy) for policy in result.policies]
    print_rows(rows, episodes, seed)


def _train_sac(env: str, steps: int, file: Path) -> None:
    """Train by the settings of RL Zoo for MuJoCo's tasks, in fewer steps, on one core."""
    import torch
    from stable_baselines3 import SAC

    torch.set_num_threads(1)
    model = SAC("MlpPolicy", env, learning_starts=10_000, seed=0, device="cpu")
    model.learn(steps)
    model.save(file)


@app.command()
def goals(episodes: Episodes = 50, seed: int = 300, folder: Folder = Path("other_processes")) -> None:
    """Compare scripted experts with agents of Stable-Baselines3 in reach and push of Fetch and Panda."""
    code, rows = EXAMPLES / "goal_tasks.py", []
    for robot, packages in GOALS.items():
        python = interpreter(folder / robot.lower(), (*packages, "stable-baselines3==2.9.2", "torch==2.13.0"))
        for task in ("Reach", "Push"):
            name = f"{robot}{task}"
            if not (folder / f"{name}.zip").exists():
                subprocess.run([python, code, name], cwd=folder, check=True, stdout=sys.stderr)
            policies = {"scripted expert": f"{name}Expert", "SAC": f"{name}Agent"}
            env = f"{robot.lower()}_{task.lower()}"
            result = comparison(python, code, env, policies, episodes, seed, folder, {})
            rows += [(name, policy) for policy in result.policies]
    print_rows(rows, episodes, seed)


@app.command()
def safe_control(
    episodes: Episodes = 50, seed: int = 300, folder: Folder = Path("other_processes"), source: str = SOURCE
) -> None:
    """Compare LQR and MPC of safe-control-gym on its quadrotor."""
    python = interpreter(folder / "safe_control", SAFE_CONTROL, source)
    policies = {"LQR": "LQR", "MPC": "MPC"}
    code, options = EXAMPLES / "safe_control.py", {"success_key": "goal_reached"}
    result = comparison(python, code, "Quadrotor", policies, episodes, seed, folder, options)
    print_rows([("quadrotor", policy) for policy in result.policies], episodes, seed)


def interpreter(home: Path, packages: Iterable[str], source: str = "") -> Path:
    """Return the Python of a virtual environment with these packages, and one without what it requires."""
    python, complete = home.resolve() / "bin" / "python", home.resolve() / "complete"
    if not complete.exists():
        pip = [str(python), "-m", "pip", "install", "--quiet"]
        subprocess.run([sys.executable, "-m", "venv", "--clear", home], check=True)
        subprocess.run([*pip, *packages], check=True, stdout=sys.stderr)
        if source:
            subprocess.run([*pip, "--no-deps", source], check=True, stdout=sys.stderr)
        complete.touch()
    return python


def comparison(
    python: Path,
    code: Path,
    env: str,
    policies: dict[str, str],
    episodes: int,
    seed: int,
    folder: Path,
    options: dict[str, Any],
) -> Any:
    """Play policies in an environment, both by another Python, in a folder."""
    names = {label: f"python={python}:{code}:{name}" for label, name in policies.items()}
    with contextlib.chdir(folder):
        return compare(
            names, f"python={python}:{code}:{env}", episodes=episodes, seed=seed, timeout=SECONDS, env_options=options
        )


def print_rows(rows: Iterable[tuple[str, PolicySummary]], episodes: int, seed: int) -> None:
    """Print a table with a row for each policy in a task."""
    table = markdown_table("task", "policy", "success %", "median return", "control steps")
    for task, policy in rows:
        success, steps = policy.success, policy.restricted_steps
        assert success is not None
        table.add_row(
            task,
            policy.policy,
            f"{100 * success.value:.0f} ({100 * success.low:.0f} to {100 * success.high:.0f})",
            f"{policy.median_return.value:.3g}" if policy.median_return else "-",
            f"{steps.value:.0f}" if steps else "-",
        )
    show(table)
    print(f"{episodes} episodes of seed {seed}, armctl {armctl.__version__}")


if __name__ == "__main__":
    app()
