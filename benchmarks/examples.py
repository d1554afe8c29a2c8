"""Success of the examples' learners: trainings with several seeds, each judged on the same held-out episodes.

    python benchmarks/examples.py --train [--only sb3_ppo]    # what is missing: hours; goes on where it was interrupted
    python benchmarks/examples.py                             # the table of what was trained

Each training is a row of `benchmarks/examples.csv`, also if it failed. What was trained before a script's code changed
(its comments do not count) is missing, and marked in the table. Each training gets one thread.
"""

import ast
import datetime
import hashlib
import os
import re
import resource
import shlex
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from rich.box import MARKDOWN
from rich.console import Console
from rich.markup import escape
from rich.progress import track
from rich.table import Table

import armctl
from armctl.stats.intervals import success_rate

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "examples.csv"
EPISODES = 200
FIRST_SEED = 10**9
"""The training seeds are multiples of it."""
TRAININGS = {
    "sb3_ppo.py": 3,
    "sb3_ppo.py --settings defaults --steps 500000": 3,
    "sb3_sac_her.py": 3,
    "sb3_ppo_bridge_cnn.py": 3,
    "one_file_ppo.py": 1,
    "cleanrl_unmodified.py": 1,
    "skrl_ppo.py": 1,
    "torchrl_ppo.py": 1,
    "sbx_ppo.py": 1,
    "sb3_contrib_recurrent_ppo.py": 1,
    "minari_imitation_bc.py": 1,
    "ppo.yml": 1,
    "sac.yml": 1,
}
"""Number of seeds of each: scripts of `examples/` with arguments, and settings of `rl/zoo/`."""


def main(
    train: Annotated[bool, typer.Option("--train", help="Train what is missing.")] = False,
    only: Annotated[str, typer.Option(metavar="TEXT", help="Trainings whose command contains this.")] = "",
) -> None:
    """Train the examples, and print a table."""
    chosen = {command: seeds for command, seeds in TRAININGS.items() if only in command}
    missing = [
        (command, seed)
        for command, seeds in chosen.items()
        for seed in range(FIRST_SEED, FIRST_SEED * (seeds + 1), FIRST_SEED)
        if (seed, _code(command)) not in set(zip(trained(command).seed, trained(command).code, strict=True))
    ]
    if train:
        for command, seed in track(missing, "training", console=Console(stderr=True)):
            row = pd.DataFrame([_train(command, seed)])
            row.to_csv(RESULTS, mode="a", header=not RESULTS.exists(), index=False)
    Console().print(table(chosen))


def trained(command: str) -> pd.DataFrame:
    """Return the last trainings by a command that had the same code."""
    if not RESULTS.exists():
        return pd.DataFrame(columns=["seed", "code"])
    rows = pd.read_csv(RESULTS, dtype={"code": str})
    rows = rows[rows.command == command]
    return rows[rows.code == rows.code.tail(1).squeeze()] if len(rows) else rows


def expected(command: str) -> str:
    """Return what the head of a script says of its trainings."""
    rows = trained(command)
    rates = ", ".join("failed" if pd.isna(k) else f"{k / EPISODES:.1%}" for k in rows.successes)
    minutes = max(1, round(rows.processor_s.max() / 60))
    of = f"of {EPISODES} episodes after {rows.steps.iloc[0]:,} steps"
    return f"{rates} {of}, in {minutes} {'minute' if minutes == 1 else 'minutes'} of one core"


def table(commands: dict[str, int]) -> Table:
    """Return what was trained, by command."""
    table = Table("training", "steps", "success of each seed, 95 % interval", "processor minutes, mean", box=MARKDOWN)
    for command in commands:
        rows = trained(command)
        if rows.empty:
            continue
        file, *words = shlex.split(command)
        link = escape(f"[{file}](../{_path(command).relative_to(ROOT)})")
        since = "" if rows.code.iloc[0] == _code(command) else " (before its last change)"
        table.add_row(
            " ".join((link, *words)) + since,
            f"{rows.steps.iloc[0]:,}",
            escape(", ".join("failed" if pd.isna(k) else _rate(k) for k in rows.successes)),
            f"{rows.processor_s.mean() / 60:.0f}",
        )
    return table


def _rate(successes: float) -> str:
    rate = success_rate(np.arange(EPISODES) < successes)
    assert rate is not None
    return f"{rate.value:.1%} [{100 * rate.low:.1f}, {100 * rate.high:.1f}]"


def _path(command: str) -> Path:
    file = shlex.split(command)[0]
    return ROOT / ("examples" if file.endswith(".py") else "rl/zoo") / file


def _code(command: str) -> str:
    """Return the fingerprint of what a command runs, without comments."""
    text = _path(command).read_text()
    if command.endswith(".yml"):
        code = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    else:
        script = ast.parse(text)
        script.body = [part for part in script.body if not _is_comment(part)]
        code = ast.unparse(script)
    return hashlib.sha256(code.encode()).hexdigest()[:12]


def _is_comment(part: ast.stmt) -> bool:
    return isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant)


def _train(command: str, seed: int) -> dict[str, object]:
    wall, processor = time.monotonic(), _processor_seconds()
    with TemporaryDirectory() as folder:
        successes = (_script if shlex.split(command)[0].endswith(".py") else _zoo)(command, seed, Path(folder))
    return {
        "date": datetime.date.today(),
        "command": command,
        "code": _code(command),
        "seed": seed,
        "steps": _steps(command),
        "successes": successes,
        "processor_s": round(_processor_seconds() - processor),
        "wall_s": round(time.monotonic() - wall),
    }


def _script(command: str, seed: int, folder: Path) -> int | None:
    """Return the successes of a script's training, out of `EPISODES`; None if it failed."""
    _, *words = shlex.split(command)
    output = _output([_path(command), *words, "--seed", str(seed), "--episodes", str(EPISODES)], folder)
    match = re.search(r"^success on \d+ held-out episodes: ([\d.]+)%", output or "", re.MULTILINE)
    return round(float(match[1]) / 100 * EPISODES) if match else None


def _zoo(command: str, seed: int, folder: Path) -> int | None:
    """Return the successes of an agent that rl-zoo3 has trained, out of `EPISODES`; None if it failed."""
    env, algorithm = "armctl/ArmReach-v0", _path(command).stem
    learn = f"--algo {algorithm} --env {env} --gym-packages armctl --eval-freq -1 --seed {seed}"
    if _output(["-m", "rl_zoo3.train", *learn.split(), "--conf-file", _path(command)], folder) is None:
        return None
    [model] = folder.glob(f"logs/{algorithm}/*/*.zip")
    options = ["actions=normalized", "control=relative", "observation=features", *["goal=True"] * (algorithm == "sac")]
    words = [word for option in options for word in ("--set", option)]
    if (
        _output(["-m", "armctl", "export", model, "--env", env, *words, "--out", "agent.onnx", "--trust"], folder)
        is None
    ):
        return None
    result = armctl.evaluate(folder / "agent.json", env, episodes=EPISODES, worlds=50, lower_bound_steps=False)
    return int(result.success.sum())


def _output(words: list[str | Path], folder: Path) -> str | None:
    """Return what Python prints with these arguments; None, and its errors shown, if it fails."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        print(done.stderr[-3000:], file=sys.stderr)
        return None
    return done.stdout


def _steps(command: str) -> int:
    if command.endswith(".yml"):
        pattern, text = r"n_timesteps: !!float (\S+)", _path(command).read_text()
    elif "--steps" in command:
        pattern, text = r"--steps (\d+)", command
    else:
        pattern, text = r"arguments\(__doc__, steps=([\d_]+)", _path(command).read_text()
    match = re.search(pattern, text)
    assert match
    return int(float(match[1]))


def _processor_seconds() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return children.ru_utime + children.ru_stime


if __name__ == "__main__":
    typer.run(main)
