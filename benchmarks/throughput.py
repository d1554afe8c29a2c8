"""Steps per second of an environment beside raw `mj_step` on its model, and Stable-Baselines3's usual way.

    python benchmarks/throughput.py [--env armctl/BridgeCross-v0] [--worlds 256] [--seconds 5]

All run the same physics, with random actions. Raw is a loop over `mj_step` on all cores at once, or on one, with
nothing observed or rewarded; all that the environment adds, such as a camera, is in its own figure. The contenders
take turns, and shares are medians over the rounds, so that a busy machine slows all alike.
"""

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import gymnasium
import mujoco
import numpy as np
import typer
from rich.box import MARKDOWN
from rich.console import Console
from rich.progress import track
from rich.table import Table
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv

import armctl
from armctl.shaping import Shaped, potential_names

ROUNDS = 7
EPISODE = 100
"""Decisions."""

Contender = Callable[[float], float]
"""Runs for about that many seconds, and gives physics steps per second."""


def raw(env: str, threads: int) -> Contender:
    """`mj_step` on `threads` threads, a decision at a time, along commands that were worked out before."""
    task = gymnasium.make(env).unwrapped.task
    model, substeps, commands = task.simulation.model, task.substeps, recorded_commands(env)

    def loop(seconds: float) -> float:
        data, decisions, end = mujoco.MjData(model), 0, time.perf_counter() + seconds
        while time.perf_counter() < end:
            episode, step = divmod(decisions, EPISODE)
            if step == 0:
                mujoco.mj_resetDataKeyframe(model, data, 0)
            data.ctrl[:] = commands[episode % len(commands), step]
            mujoco.mj_step(model, data, nstep=substeps)
            decisions += 1
        return decisions * substeps / seconds

    def run(seconds: float) -> float:
        with ThreadPoolExecutor(threads) as pool:
            return sum(pool.map(loop, [seconds] * threads))

    return run


def recorded_commands(env: str, episodes: int = 256) -> np.ndarray:
    """What the motors are told (episodes, 100, nu) in episodes of random actions."""
    worlds = gymnasium.make_vec(env, num_envs=episodes)
    worlds.reset(seed=0)
    worlds.action_space.seed(0)
    ctrl, rows = worlds.unwrapped.task.simulation.array("ctrl"), []
    for _ in range(EPISODE):
        worlds.step(worlds.action_space.sample())
        rows.append(ctrl.copy())
    return np.stack(rows, axis=1)


def timed(step: Callable[[int], object], physics_steps: int) -> Contender:
    """Calls `step` with 0, 1, 2 ..., each worth `physics_steps`."""

    def run(seconds: float) -> float:
        calls, start = 0, time.perf_counter()
        while time.perf_counter() < start + seconds:
            step(calls)
            calls += 1
        return calls * physics_steps / (time.perf_counter() - start)

    return run


def batched(env: str, worlds: int, oracle: str | None = None) -> Contender:
    """`gym.make_vec`: physics, observations, rewards and resets of `worlds` worlds, shaped if an oracle is named."""
    plain = gymnasium.make_vec(env, num_envs=worlds)
    made = Shaped(plain, oracle, gamma=0.97) if oracle else plain
    made.reset(seed=0)
    made.action_space.seed(0)
    actions = [made.action_space.sample() for _ in range(50)]
    return timed(lambda i: made.step(actions[i % 50]), worlds * made.unwrapped.task.substeps)


def single(env: str) -> Contender:
    """`gym.make`, with all of Gymnasium's wrappers."""
    made = gymnasium.make(env)
    made.reset(seed=0)
    made.action_space.seed(0)
    actions = [made.action_space.sample() for _ in range(1000)]

    def step(i: int) -> None:
        _, _, terminated, truncated, _ = made.step(actions[i % 1000])
        if terminated or truncated:
            made.reset()

    return timed(step, made.unwrapped.task.substeps)


def subprocesses(env: str, worlds: int) -> Contender:
    """Stable-Baselines3's SubprocVecEnv over single environments, one process a core."""
    substeps = gymnasium.make(env).unwrapped.task.substeps
    made = make_vec_env(env, n_envs=worlds, vec_env_cls=SubprocVecEnv, vec_env_kwargs={"start_method": "fork"})
    made.reset()
    actions = [np.array([made.action_space.sample() for _ in range(worlds)]) for _ in range(50)]
    return timed(lambda i: made.step(actions[i % 50]), worlds * substeps)


def main(env: str = armctl.DEFAULT_ENV, worlds: int = 256, seconds: float = 3.0) -> None:
    """Measure, and print a table."""
    cores = len(os.sched_getaffinity(0))
    subprocess_name = f"Stable-Baselines3's `SubprocVecEnv`, {cores} processes"
    all_cores, one_core = f"raw `mj_step`, {cores} threads", "raw `mj_step`, 1 thread"
    oracles = potential_names(gymnasium.make_vec(env, num_envs=1).unwrapped)
    contenders = {
        all_cores: (raw(env, cores), all_cores),
        f"`gym.make_vec`, {worlds} worlds": (batched(env, worlds), all_cores),
        **{f"the same, shaped by `{oracle}`": (batched(env, worlds, oracle), all_cores) for oracle in oracles},
        subprocess_name: (subprocesses(env, cores), all_cores),
        one_core: (raw(env, 1), one_core),
        "`gym.make`": (single(env), one_core),
    }
    rates: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in track(range(ROUNDS), console=Console(stderr=True), transient=True):
        for name, (run, _) in contenders.items():
            rates[name].append(run(seconds))
    task = gymnasium.make(env).unwrapped.task
    timestep, substeps = task.simulation.model.opt.timestep, task.substeps
    title = f"{env}, {cores} cores, armctl {armctl.__version__}, mujoco {mujoco.__version__}"
    table = Table(
        "",
        "physics steps/s",
        "control steps/s",
        "times real time",
        "of raw",
        title=title,
        title_justify="left",
        box=MARKDOWN,
    )
    for name, (_, reference) in contenders.items():
        rate = float(np.median(rates[name]))
        share = float(np.median(np.array(rates[name]) / np.array(rates[reference])))
        table.add_row(name, f"{rate:,.0f}", f"{rate / substeps:,.0f}", f"{rate * timestep:,.0f}", f"{share:.0%}")
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
