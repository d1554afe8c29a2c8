"""Gain in speed and loss in fidelity of a larger physics step, when the rover drives on the bridge.

    python benchmarks/physics_step.py [--runs 64] [--seconds 5]

The same commands, new ones each half second, drive rovers on an empty deck with each step. Fidelity is how far their
final poses are from those with a step of 0.1 ms; beside it stands how far that pose itself moves when the step is
halved: no step can be more exact than that. Contacts at the end of the deck do not occur: it is 200 m long.
"""

import time
from typing import Any

import gymnasium
import numpy as np
import typer
from printing import markdown_table, progress, show

import armctl
from armctl.robots.rover import MAX_VELOCITY

STEPS = (0.0005, 0.001, 0.002, 0.004, 0.005, 0.01, 0.02)
"""s."""
FINE = 0.0001
"""s."""
HOLD = 5
"""Decisions for which a command stays."""


def drive(timestep: float, commands: np.ndarray) -> tuple[np.ndarray, float]:
    """Return final poses (runs, 3) after commands (decisions, runs, 2), and physics seconds simulated in a second."""
    runs = commands.shape[1]
    env: Any = gymnasium.make_vec(
        "armctl/BridgeCross-v0",
        num_envs=runs,
        max_episode_steps=10**6,
        timestep=timestep,
        blocks=0,
        deck_length=200.0,
        deck_width=20.0,
        resolution=(4, 4),
        autoreset_mode="disabled",
    )
    env.reset(seed=0)
    task = env.unwrapped.task
    elapsed = 0.0
    for command in commands:
        start = time.perf_counter()
        task.command(command)
        task.advance(None)
        elapsed += time.perf_counter() - start
    return task.rover.poses, runs * len(commands) * 0.1 / elapsed


def main(runs: int = 64, seconds: float = 5.0) -> None:
    """Measure, and print a table."""
    rng = np.random.default_rng(0)
    held = rng.uniform(-MAX_VELOCITY, MAX_VELOCITY, (round(seconds * 10) // HOLD, runs, 2))
    held[..., 0] = np.abs(held[..., 0])
    commands = np.repeat(held, HOLD, axis=0)
    poses = {}
    for step in progress((FINE / 2, FINE, *STEPS)):
        poses[step] = drive(step, commands)
    title = f"{runs} drives of {seconds:g} s, final pose against a step of {FINE * 1e3:g} ms"
    table = markdown_table(
        "step, ms", "position, mm: median", "95 %", "heading, degrees: median", "95 %", "times real time",
        title=title,
    )  # fmt: skip
    for step in (FINE / 2, *STEPS):
        reached, speed = poses[step]
        difference = reached - poses[FINE][0]
        position = 1e3 * np.linalg.norm(difference[:, :2], axis=1)
        heading = np.degrees(np.abs((difference[:, 2] + np.pi) % (2 * np.pi) - np.pi))
        figures = [np.quantile(error, q) for error in (position, heading) for q in (0.5, 0.95)]
        table.add_row(f"{step * 1e3:g}", *(f"{figure:.1f}" for figure in figures), f"{speed:,.0f}")
    show(table)
    print(f"armctl {armctl.__version__}; speed is that of the physics alone, on all cores")


if __name__ == "__main__":
    typer.run(main)
