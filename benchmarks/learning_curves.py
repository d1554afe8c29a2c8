"""Learning curves of PPO with and without an oracle's reward: several seeds each, judged on held-out episodes.

All variants learn from the task's own reward, by the same recipe, for as many steps; only the potential differs. Runs
are kept in a folder, and go on where they were interrupted; with --plot-only, what is there is shown.
"""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import typer
from printing import markdown_table, progress, show
from rich.table import Table

from armctl.core.errors import unknown_name

ENOUGH = 0.9
"""Success to be learnt."""
COLOURS = {"plain": "#8c8c8c", "distance": "#d1822b", "ik": "#1f77b4", "ompl": "#1f77b4"}


class Study(NamedTuple):
    """Variants of one recipe."""

    recipe: str
    scales: dict[str, float]
    """Reward for each unit of each oracle's potential."""
    arguments: list[str]


STUDIES = {
    "armctl/ArmReach-v0": Study("reach_ppo", {"distance": 120.0, "ik": 150.0}, ["--steps", "700000"]),
    "armctl/BridgeCross-v0": Study(
        "bridge_depth_ppo",
        {"ompl": 5.0},
        ["--steps", "300000", "--set", "resolution=(24, 16)", "--option", "validation_episodes=50"],
    ),
}


def main(
    env: Annotated[str, typer.Option(help="Environment.")] = "armctl/ArmReach-v0",
    seeds: Annotated[int, typer.Option(min=1, help="Training seeds, from 0 on.")] = 3,
    runs: Annotated[Path, typer.Option(help="Folder of the runs.")] = Path("runs/curves"),
    workers: Annotated[int, typer.Option(min=1, help="Trainings at once.")] = 2,
    plot_only: Annotated[bool, typer.Option("--plot-only", help="Train nothing.")] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Where to plot the curves; FILE.csv has them.")
    ] = None,
) -> None:
    """Train all variants, and print a table."""
    if env not in STUDIES:
        raise unknown_name("environment with learning curves", env, STUDIES)
    study, name = STUDIES[env], env.split("/")[1]
    variants = ("plain", *study.scales)
    folders = {(variant, seed): runs / f"{name}-{variant}-{seed}" for seed in range(seeds) for variant in variants}
    if not plot_only:
        with ThreadPoolExecutor(workers) as pool:
            jobs = [pool.submit(_train, study, *which, folder) for which, folder in folders.items()]
            for job in progress(jobs, "training"):
                job.result()
    curves = pd.concat(
        pd.read_csv(folder / "curve.csv").assign(variant=variant, seed=seed)
        for (variant, seed), folder in folders.items()
        if (folder / "curve.csv").exists()
    )
    show(_table(curves, env, seeds))
    if picture:
        _plot(curves, env, picture)
        curves.to_csv(picture.with_suffix(".csv"), index=False)


def _train(study: Study, variant: str, seed: int, folder: Path) -> None:
    if (folder / "agent.json").exists():
        return
    shaping = ["none"] if variant == "plain" else [variant, "--shaping-scale", str(study.scales[variant])]
    resume = ["--resume"] if (folder / "settings.json").exists() else []
    common = ["--option", "evaluation_every=50000", "--option", "evaluation_episodes=200", "--out", str(folder)]
    command = ["train", study.recipe, "--seed", str(seed), "--shaping", *shaping, *study.arguments, *common, *resume]
    folder.parent.mkdir(parents=True, exist_ok=True)
    with folder.with_suffix(".log").open("a") as log:
        subprocess.run([sys.executable, "-m", "armctl", *command], check=True, stdout=log, stderr=log)


def _table(curves: pd.DataFrame, env: str, seeds: int) -> Table:
    table = markdown_table(
        "potential", f"control steps to {ENOUGH:.0%}: median and range of seeds", "minutes", "in the end",
        "range of seeds", title=f"{env}, {seeds} seeds",
    )  # fmt: skip
    for variant, runs in curves.groupby("variant", sort=False):
        first = [run[run.success >= ENOUGH].head(1) for _, run in runs.groupby("seed")]
        reached = pd.concat(first)
        ends = np.array([run.success.iloc[-1] for _, run in runs.groupby("seed")])
        missing = "" if len(reached) == len(first) else f" ({len(first) - len(reached)} never)"
        steps, minutes = (
            "never"
            if reached.empty
            else f"{reached[column].median():,.{digits}f} [{reached[column].min():,.{digits}f}, "
            f"{reached[column].max():,.{digits}f}]{missing}"
            for column, digits in (("steps", 0), ("minutes", 1))
        )
        table.add_row(str(variant), steps, minutes, f"{ends.mean():.0%}", f"{ends.min():.0%} to {ends.max():.0%}")
    return table


def _plot(curves: pd.DataFrame, env: str, picture: Path) -> None:
    figure, axes = plt.subplots(figsize=(7, 3.6), dpi=150, layout="constrained")
    for variant, runs in curves.groupby("variant", sort=False):
        table = runs.pivot_table(index="steps", columns="seed", values="success").dropna()
        axes.plot(table.index / 1e6, table.mean(axis=1), color=COLOURS[str(variant)], label=str(variant))
        axes.fill_between(
            table.index / 1e6, table.min(axis=1), table.max(axis=1), color=COLOURS[str(variant)], alpha=0.2, linewidth=0
        )
    axes.axhline(ENOUGH, color="black", linewidth=0.5, linestyle=":")
    axes.set(xlabel="million decisions", ylabel="success on held-out episodes", ylim=(-0.02, 1.02), title=env)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, title="reward on the way", loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(picture)


if __name__ == "__main__":
    typer.run(main)
