"""Steps per second of an environment beside raw `mj_step` on its model, and Stable-Baselines3's usual way.

    python benchmarks/throughput.py [--env armctl/BridgeCross-v0] [--worlds 256] [--seconds 1]

All with random actions. Raw is a loop over `mj_step` on all cores at once, or on one, from the states and with the
motors' commands of such episodes, with nothing observed or rewarded, and without MuJoCo's clock, like environments; all
that the environment adds, such as a camera, is in its own figure. Environments repeat the ticks in which something was
hit hard in finer steps: a second raw loop makes as many, and is the same physics. The contenders take turns, and shares
are medians over the rounds, so that a busy machine slows all alike.
"""

import copy
import itertools
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import gymnasium
import mujoco
import numpy as np
import typer
from printing import markdown_table, progress, show
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import SubprocVecEnv

import armctl
from armctl.shaping import Shaped, potential_names
from armctl.simulation.control_step import CLOCK
from armctl.simulation.impacts import FINER

ROUNDS = 35
"""Many short ones: the machine's speed changes within seconds, and shares are those of neighbours."""
EPISODE = 100
"""Decisions."""

Contender = Callable[[float], float]
"""Runs for about that many seconds, and gives physics steps per second."""


@dataclass(frozen=True)
class Recording:
    """Episodes of random actions, decision by decision, in some worlds: (decisions, worlds, ...) each."""

    states: np.ndarray
    """States at the decisions."""
    fields: dict[str, np.ndarray]
    """Fields of models, where worlds have their own."""
    commands: np.ndarray
    """Commands of the motors."""
    refined: np.ndarray
    """Ticks of the drives that are repeated in finer steps."""

    @classmethod
    def of(cls, env: str, num_envs: int = 32) -> "Recording":
        """Play the first episodes of `num_envs` worlds."""
        vec_env: Any = gymnasium.make_vec(env, num_envs=num_envs)
        vec_env.reset(seed=0)
        vec_env.action_space.seed(0)
        simulation, rows = vec_env.unwrapped.task.simulation, []
        ctrl = simulation.array("ctrl")
        for _ in range(EPISODE):
            live = {name: values.copy() for name, values in simulation.live_arrays.items()}
            vec_env.step(vec_env.action_space.sample())
            rows.append(live | {"ctrl": ctrl.copy(), "refined": simulation.refined.copy()})
        stacked = {name: np.stack([row[name] for row in rows]) for name in rows[0] if name != "unstable"}
        return cls(stacked.pop("state"), commands=stacked.pop("ctrl"), refined=stacked.pop("refined"), fields=stacked)


def raw(env: str, threads: int, finer: bool) -> Contender:
    """Run `mj_step` on `threads` threads, from states and along commands of a recording, a decision at a time."""
    task, recording = gymnasium.make(env).get_wrapper_attr("task"), Recording.of(env)
    fine_steps = finer * FINER * recording.refined * (task.substeps // len(task.joints.part.speeds))

    def loop(seconds: float) -> float:
        model, fine_model = copy.copy(task.simulation.model), copy.copy(task.simulation.model)
        fine_model.opt.timestep /= FINER
        data, decisions = mujoco.MjData(model), 0
        CLOCK.value = None
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            world, step = divmod(decisions, EPISODE)
            moment = step, world % recording.states.shape[1]
            for name, values in recording.fields.items():
                getattr(model, name)[: len(values[moment])] = values[moment]
            mujoco.mj_setState(model, data, recording.states[moment], mujoco.mjtState.mjSTATE_INTEGRATION)
            data.ctrl[:] = recording.commands[moment]
            mujoco.mj_step(model, data, nstep=task.substeps)
            if count := fine_steps[moment]:
                mujoco.mj_step(fine_model, data, nstep=count)
            decisions += 1
        return decisions * task.substeps / seconds

    def run(seconds: float) -> float:
        with ThreadPoolExecutor(threads) as pool:
            return sum(pool.map(loop, [seconds] * threads))

    return run


def timed(step: Callable[[int], object], physics_steps: int) -> Contender:
    """Time `step` with 0, 1, 2 ..., each worth `physics_steps`. Rounds go on where the last one has ended.

    Rounds of few steps would repeat their first actions, with which rovers collide two to three times as often.
    """
    numbers = itertools.count()

    def run(seconds: float) -> float:
        calls, start = 0, time.perf_counter()
        while time.perf_counter() < start + seconds:
            step(next(numbers))
            calls += 1
        return calls * physics_steps / (time.perf_counter() - start)

    return run


def batched(env: str, num_envs: int, oracle: str | None = None) -> Contender:
    """Run `gym.make_vec`: physics, observations, rewards and resets of `num_envs` worlds, shaped by a named oracle."""
    plain: Any = gymnasium.make_vec(env, num_envs=num_envs)
    shaped: Any = Shaped(plain, oracle, gamma=0.97) if oracle else plain
    shaped.reset(seed=0)
    shaped.action_space.seed(0)
    actions = [shaped.action_space.sample() for _ in range(50)]
    return timed(lambda i: shaped.step(actions[i % 50]), num_envs * shaped.unwrapped.task.substeps)


def single(env: str) -> Contender:
    """Run `gym.make`, with all of Gymnasium's wrappers."""
    single_env = gymnasium.make(env)
    single_env.reset(seed=0)
    single_env.action_space.seed(0)
    actions = [single_env.action_space.sample() for _ in range(1000)]

    def step(i: int) -> None:
        _, _, terminated, truncated, _ = single_env.step(actions[i % 1000])
        if terminated or truncated:
            single_env.reset()

    return timed(step, single_env.get_wrapper_attr("task").substeps)


def subprocesses(env: str, num_envs: int) -> Contender:
    """Run Stable-Baselines3's SubprocVecEnv over single environments, one process a core."""
    substeps = gymnasium.make(env).get_wrapper_attr("task").substeps
    vec_env = make_vec_env(env, n_envs=num_envs, vec_env_cls=SubprocVecEnv, vec_env_kwargs={"start_method": "fork"})
    vec_env.reset()
    actions = [np.array([vec_env.action_space.sample() for _ in range(num_envs)]) for _ in range(50)]
    return timed(lambda i: vec_env.step(actions[i % 50]), num_envs * substeps)


def main(env: str = armctl.DEFAULT_ENV, worlds: int = 256, seconds: float = 0.5) -> None:
    """Measure, and print a table."""
    cores = len(os.sched_getaffinity(0))
    plain: Any = gymnasium.make_vec(env, num_envs=1).unwrapped
    oracles, bare, refined = potential_names(plain), {}, {}
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
    for _ in progress(range(ROUNDS)):
        for name, (run, _) in contenders.items():
            rates[name].append(run(seconds))
    task = gymnasium.make(env).get_wrapper_attr("task")
    timestep, substeps = task.simulation.model.opt.timestep, task.substeps
    title = f"{env}, {cores} cores, armctl {armctl.__version__}, mujoco {mujoco.__version__}"
    columns = ("", "physics steps/s", "control steps/s", "times real time", "of raw", "of raw with finer steps")
    table = markdown_table(*columns, title=title)
    for name, (_, threads) in contenders.items():
        rate = float(np.median(rates[name]))
        shares = [
            f"{np.median(np.divide(rates[name], rates[reference])):.0%}"
            for reference in (bare[threads], refined[threads])
        ]
        table.add_row(name, f"{rate:,.0f}", f"{rate / substeps:,.0f}", f"{rate * timestep:,.0f}", *shares)
    show(table)


if __name__ == "__main__":
    typer.run(main)
