"""Packages that cannot stand beside armctl, each in a virtual environment of its own, made here.

    python benchmarks/other_processes.py metaworld [--episodes 50] [--seed 300] [--folder other_processes]
    python benchmarks/other_processes.py safe-control [--source git+https://...]

`metaworld` trains a SAC agent for reach and for push in the environment's own Python, and compares each with
Meta-World's scripted expert: minutes of one core. `safe-control` compares the LQR and the MPC of safe-control-gym,
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
