"""Steps per second of an environment beside raw `mj_step` on its model, and Stable-Baselines3's usual way.

    python benchmarks/throughput.py [--env armctl/BridgeCross-v0] [--worlds 256] [--seconds 5]

All with random actions. Raw is a loop over `mj_step` on all cores at once, or on one, from the states and with the
motors' commands of such episodes, with nothing observed or rewarded; all that the environment adds, such as a camera,
is in its own figure. Environments repeat the ticks in which something was hit hard in finer steps: a second raw loop
makes as many, and is the same physics. The contenders take turns, and shares are medians over the rounds, so that a
busy machine slows all alike.
"""

import copy
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

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
from armctl.simulation.impacts import FINER

ROUNDS = 7
EPISODE = 100
"""Decisions."""

Contender = Callable[[float], float]
"""Runs for about that many seconds, and gives physics steps per second."""


@dataclass(frozen=True)
class Recording:
    """Episodes of random actions, decision by decision, in some worlds: (decisions, worlds, ...) each."""

    states: np.ndarray
    """At the decisions."""
    fields: dict[str, np.ndarray]
    """Of models, where worlds have their own."""
    commands: np.ndarray
    """What the motors are told."""
    refined: np.ndarray
    """Ticks of the drives that are repeated in finer steps."""

    @classmethod
    def of(cls, env: str, worlds: int = 32) -> "Recording":
        """Play the first episodes of `worlds` worlds."""
        made = gymnasium.make_vec(env, num_envs=worlds)
        made.reset(seed=0)
        made.action_space.seed(0)
        simulation, rows = made.unwrapped.task.simulation, []
        ctrl = simulation.array("ctrl")
        for _ in range(EPISODE):
            live = {name: values.copy() for name, values in simulation.live_arrays.items()}
            made.step(made.action_space.sample())
            rows.append(live | {"ctrl": ctrl.copy(), "refined": simulation.refined.copy()})
        stacked = {name: np.stack([row[name] for row in rows]) for name in rows[0] if name != "unstable"}
        return cls(stacked.pop("state"), commands=stacked.pop("ctrl"), refined=stacked.pop("refined"), fields=stacked)


def raw(env: str, threads: int, finer: bool) -> Contender:
    """`mj_step` on `threads` threads, from the states and along the commands of a recording, a decision at a time."""
    task, played = gymnasium.make(env).unwrapped.task, Recording.of(env)
    fine_steps = finer * FINER * played.refined * (task.substeps // len(task.joints.part.speeds))

    def loop(seconds: float) -> float:
        model, fine_model = copy.copy(task.simulation.model), copy.copy(task.simulation.model)
        fine_model.opt.timestep /= FINER
        data, decisions, end = mujoco.MjData(model), 0, time.perf_counter() + seconds
        while time.perf_counter() < end:
            world, step = divmod(decisions, EPISODE)
            now = step, world % played.states.shape[1]
            for name, values in played.fields.items():
                getattr(model, name)[: len(values[now])] = values[now]
            mujoco.mj_setState(model, data, played.states[now], mujoco.mjtState.mjSTATE_INTEGRATION)
            data.ctrl[:] = played.commands[now]
            mujoco.mj_step(model, data, nstep=task.substeps)
            if count := fine_steps[now]:
                mujoco.mj_step(fine_model, data, nstep=count)
            decisions += 1
        return decisions * task.substeps / seconds

    def run(seconds: float) -> float:
        with ThreadPoolExecutor(threads) as pool:
            return sum(pool.map(loop, [seconds] * threads))

    return run


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
    oracles = potential_names(gymnasium.make_vec(env, num_envs=1).unwrapped)
    bare, refined = {}, {}
    for threads, label in ((cores, f"{cores} threads"), (1, "1 thread")):
        bare[threads], refined[threads] = f"raw `mj_step`, {label}", f"raw with finer steps, {label}"
    contenders = {
        bare[cores]: (raw(env, cores, False), cores),
        refined[cores]: (raw(env, cores, True), cores),
        f"`gym.make_vec`, {worlds} worlds": (batched(env, worlds), cores),
        **{f"the same, shaped by `{oracle}`": (batched(env, worlds, oracle), cores) for oracle in oracles},
        f"Stable-Baselines3's `SubprocVecEnv`, {cores} processes": (subprocesses(env, cores), cores),
        bare[1]: (raw(env, 1, False), 1),
        refined[1]: (raw(env, 1, True), 1),
        "`gym.make`": (single(env), 1),
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
        "of raw with finer steps",
        title=title,
        title_justify="left",
        box=MARKDOWN,
    )
    for name, (_, threads) in contenders.items():
        rate = float(np.median(rates[name]))
        shares = [
            f"{np.median(np.divide(rates[name], rates[reference])):.0%}"
            for reference in (bare[threads], refined[threads])
        ]
        table.add_row(name, f"{rate:,.0f}", f"{rate / substeps:,.0f}", f"{rate * timestep:,.0f}", *shares)
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
