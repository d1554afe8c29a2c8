"""Processor time of resets beside MuJoCo's own `mj_resetData` and `mj_forward` on the same models.

    python benchmarks/resets.py [--rounds 7]

256 worlds among obstacles, whose layouts and certificates come from the pool, and without it. 4,096 bridges, made and
reset, camera images included. The contenders of each table take turns, and shares are medians over the rounds, so that
a busy machine slows all alike. Without the pool and on bridges there are fewer rounds and worlds.
"""

import time
from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
import numpy as np
import typer
from printing import markdown_table, show
from rich.console import Console
from rich.progress import track
from rich.table import Table

import armctl

OBSTACLES, BRIDGE = "armctl/ArmReachObstacles-v0", "armctl/BridgeCross-v0"
WORLDS, BRIDGES = 256, 4096
LIVE_WORLDS = 16
"""A tolerance that is not the pool's: layouts are planned at each reset."""
FIRST_SEED = 10_000
"""Past the test's seed."""

Contender = Callable[[int], int]
"""Resets in round 0, 1, 2 ..., and gives the number of worlds."""


def raw(env: str, num_envs: int) -> Contender:
    """Run MuJoCo's own reset of as many worlds, one after the other."""
    model = gymnasium.make(env).get_wrapper_attr("task").simulation.model
    data = mujoco.MjData(model)

    def reset(_: int) -> int:
        for _ in range(num_envs):
            mujoco.mj_resetDataKeyframe(model, data, 0)
            mujoco.mj_forward(model, data)
        return num_envs

    return reset


def batched(env: str, num_envs: int, **options: Any) -> Contender:
    """`reset` of worlds that are made already, each time with seeds of its own."""
    vec_env = gymnasium.make_vec(env, num_envs=num_envs, **options)
    vec_env.reset(seed=0)  # reads the pool

    def reset(number: int) -> int:
        vec_env.reset(seed=FIRST_SEED + num_envs * number)
        return num_envs

    return reset


def made_and_reset(env: str, num_envs: int) -> Contender:
    """Run `gym.make_vec`, and one `reset`."""

    def reset(number: int) -> int:
        vec_env = gymnasium.make_vec(env, num_envs=num_envs)
        vec_env.reset(seed=FIRST_SEED + num_envs * number)
        vec_env.close()
        return num_envs

    return reset


def measured(contenders: dict[str, Contender], rounds: int, title: str) -> Table:
    """Return processor time in all and a world, and how many times the first contender's a world."""
    taken = np.zeros((len(contenders), rounds))
    num_envs = np.zeros(len(contenders))
    for number in track(range(rounds), console=Console(stderr=True), transient=True, auto_refresh=False):
        for i, run in enumerate(contenders.values()):
            begin = time.process_time()
            num_envs[i] = run(number)
            taken[i, number] = time.process_time() - begin
    milliseconds = 1e3 * taken / num_envs[:, None]
    columns = "", "processor s in all", "processor ms a world", "most", "times raw"
    table = markdown_table(*columns, title=title)
    for name, total, each in zip(contenders, taken, milliseconds, strict=True):
        share = np.median(each / milliseconds[0])
        table.add_row(name, f"{np.median(total):.3f}", f"{np.median(each):.3f}", f"{each.max():.3f}", f"{share:.1f}")
    return table


def main(rounds: int = 7) -> None:
    """Measure, and print two tables."""
    versions = f"armctl {armctl.__version__}, mujoco {mujoco.__version__}"
    obstacles = {
        "raw MuJoCo": raw(OBSTACLES, WORLDS),
        f"`reset` of {WORLDS} worlds": batched(OBSTACLES, WORLDS),
        "the same, `solvable=False`": batched(OBSTACLES, WORLDS, solvable=False),
        f"`reset` of {LIVE_WORLDS} worlds without the pool": batched(OBSTACLES, LIVE_WORLDS, tolerance=0.049),
    }
    bridges = {
        "raw MuJoCo": raw(BRIDGE, BRIDGES),
        f"`gym.make_vec` and `reset` of {BRIDGES:,} worlds": made_and_reset(BRIDGE, BRIDGES),
    }
    for env, contenders, times in ((OBSTACLES, obstacles, rounds), (BRIDGE, bridges, min(rounds, 3))):
        show(measured(contenders, times, f"{env}, {versions}"))


if __name__ == "__main__":
    typer.run(main)
