"""Learning curves of agents for each task, against processor time: all training seeds, and the experts as lines.

Curves are those beside the agents' cards, of held-out episodes; experts play others. Where a curve is older than the
count of processor time, wall time stands for it.
"""

import math
from contextlib import closing
from pathlib import Path
from typing import Annotated

import matplotlib.pyplot as plt
import pandas as pd
import typer
from matplotlib.axes import Axes
from rich.progress import track

from armctl.agents import AgentCard, read_card
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.policies.find import is_expert
from armctl.rl.agents import AGENTS
from armctl.rollout import evaluate
from armctl.study.curves import read_curve
from armctl.study.line_up import default_policies

COLUMNS = 3


def main(
    picture: Annotated[Path, typer.Argument(metavar="FILE.png", help="Where to plot the curves.")],
    episodes: Annotated[int, typer.Option(min=1, help="Episodes of each expert.")] = 100,
) -> None:
    """Plot the curves of all agents that come with armctl, a panel for each task."""
    cards = [path for path in sorted((AGENTS).rglob("*.json")) if path.with_suffix(".csv").exists()]
    agents = [(read_card(path), read_curve(path.with_suffix(".csv"))) for path in cards]
    tasks = sorted({card.env for card, _ in agents})
    experts = [(env, name) for env in tasks for name in _untrained(env)]
    success = {
        (env, name): evaluate(name, env, episodes=episodes, lower_bound_steps=False).success.mean()
        for env, name in track(experts, "experts")
    }
    rows = math.ceil(len(tasks) / COLUMNS)
    figure, axes = plt.subplots(
        rows, COLUMNS, figsize=(4 * COLUMNS, 3.6 * rows), sharey=True, squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(tasks) :]:
        axis.remove()
    for axis, env in zip(axes.flat, tasks, strict=False):
        _plot(axis, [(card, curve) for card, curve in agents if card.env == env])
        values = sorted({value for (where, _), value in success.items() if where == env})
        for value, higher in zip(values, [*values[1:], math.inf], strict=True):
            names = ", ".join(name for (where, name), same in success.items() if (where, same) == (env, value))
            axis.axhline(value, color="black", linewidth=0.8, linestyle=":")
            side = "top" if higher - value < 0.05 else "bottom"
            axis.annotate(names, (0.01, value), xycoords=("axes fraction", "data"), fontsize=7, va=side)
        axis.set(title=env.removeprefix("armctl/"), xscale="log", xlabel="minutes of processor", ylim=(0, 1.08))
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter("")
        axis.set_xlim(left=0.5)
        axis.legend(fontsize=8, loc="lower right")
    for axis in axes[:, 0]:
        axis.set_ylabel("success on held-out episodes")
    figure.savefig(picture, dpi=110)


def _plot(axis: Axes, agents: list[tuple[AgentCard, pd.DataFrame]]) -> None:
    """Draw a line for each training; those of one recipe share a colour."""
    colours = {recipe: f"C{i}" for i, recipe in enumerate(sorted({str(card.recipe) for card, _ in agents}))}
    for recipe, colour in colours.items():
        label: str | None = recipe
        for card, curve in agents:
            if card.recipe == recipe:
                minutes = (curve.processor_seconds / 60).fillna(curve.minutes)
                axis.plot(minutes.clip(lower=0.5), curve.success, color=colour, label=label, linewidth=1.2)
                label = None


def _untrained(env: str) -> list[str]:
    """Return the experts of a task's default line-up."""
    with closing(make_worlds(env, 1)) as worlds:
        names = [name for name in default_policies(env) if is_expert(name)]
        return [name for name in names if make_policy(name, worlds).training_steps == 0]


if __name__ == "__main__":
    typer.run(main)
