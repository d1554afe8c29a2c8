"""Combinations of learner libraries and environments that work, alone or batched, in each autoreset mode.

    python benchmarks/learners.py [--only torchrl] [--env armctl/ArmReach-v0]

Each combination is made, and stepped by the library itself beyond the end of an episode. It works if that raises no
error, and if all worlds were stepped for longer than an episode. Otherwise, its cell has the library's own error, or a
reason that is kept here, where no error tells. Each library runs in a process of its own.
"""

import contextlib
import importlib
import io
import json
import os
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import typer
from printing import markdown_table, show

import armctl  # noqa: F401 - registers the environments
from armctl.core.registration import environment_names

WAYS = ("gymnasium.make", "next_step", "same_step", "disabled")
"""Ways to make an environment: one world, or several in an autoreset mode."""
WORLDS, LIMIT, STEPS = 2, 4, 16
"""Worlds, control steps of an episode, and control steps of each world."""
LONGEST = 110
"""Characters of an error."""
Env = Any
Learner = Callable[[str, str], Env]
"""Steps an environment in one of the `WAYS`, and returns it, or None if that cannot be asked for its episodes."""


class StepCounter:
    """Counts the control steps of each world, without those in which it stood still after an episode."""

    def __init__(self) -> None:
        self.counts: Any = 0

    def began(self, ids: Any) -> None:
        """Take note that worlds `ids` have begun an episode."""

    def stepped(self, awake: Any) -> None:
        """Take note that the worlds in the mask have made a step."""
        self.counts = self.counts + awake


def make(env: str, way: str, **options: Any) -> Env:
    """Make an environment with short episodes, whose steps are counted."""
    options |= {"actions": "normalized", "max_episode_steps": LIMIT}
    if way == "gymnasium.make":
        result: Any = gymnasium.make(env, **options)
        result.unwrapped.worlds.observers.append(StepCounter())
    else:
        result = gymnasium.make_vec(env, num_envs=WORLDS, autoreset_mode=way, **options)
        result.observers.append(StepCounter())
    return result


def gymnasium_alone(env: str, way: str) -> Env:
    """Run a loop such as CleanRL's; without autoreset, it resets worlds by `reset_mask`."""
    worlds = make(env, way)
    worlds.reset(seed=0)
    for _ in range(STEPS):
        *_, terminated, truncated, _ = worlds.step(worlds.action_space.sample())
        ends = np.asarray(terminated | truncated)
        if way == "gymnasium.make" and ends:
            worlds.reset()
        elif way == "disabled" and ends.any():
            worlds.reset(options={"reset_mask": ends})
    return worlds


def _for_stable_baselines(env: str, way: str, **options: Any) -> tuple[Env, Env]:
    """Make an environment, and the same as Stable-Baselines3 takes it."""
    from armctl.integrations.sb3 import VecEnv

    plain = make(env, way, **options)
    return plain, plain if way == "gymnasium.make" else VecEnv(plain)


def _on_policy(library: str, algorithm: str, network: str = "") -> Learner:
    def learn(env: str, way: str) -> Env:
        plain, adapted = _for_stable_baselines(env, way)
        several = isinstance(adapted.observation_space, gymnasium.spaces.Dict)
        policy = f"{'MultiInput' if several else 'Mlp'}{network}Policy"
        make_model = getattr(importlib.import_module(library), algorithm)
        model = make_model(policy, adapted, n_steps=STEPS, batch_size=STEPS, n_epochs=1, device="cpu")
        model.learn(STEPS * (1 if way == "gymnasium.make" else WORLDS))
        return plain

    return learn


def hindsight(env: str, way: str) -> Env:
    """Run SAC with hindsight experience replay, of Stable-Baselines3."""
    from stable_baselines3 import SAC, HerReplayBuffer

    plain, adapted = _for_stable_baselines(env, way, goal=True)
    steps = 2 * STEPS * WORLDS
    SAC("MultiInputPolicy", adapted, replay_buffer_class=HerReplayBuffer, learning_starts=steps // 2).learn(steps)
    return plain


def zoo(env: str, way: str) -> None:
    """Run rl-zoo3's command, with hyper-parameters such as those in `rl/zoo/`."""
    settings = f"""
{env}:
  env_kwargs: {{actions: normalized, max_episode_steps: {LIMIT}}}
  n_timesteps: {STEPS}
  n_envs: 1
  policy: {"MlpPolicy" if "Arm" in env else "MultiInputPolicy"}
  n_steps: {STEPS}
  batch_size: {STEPS}
"""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "ppo.yml").write_text(settings)
        words = f"--algo ppo --env {env} --gym-packages armctl --conf-file ppo.yml --log-folder logs --eval-freq -1"
        done = subprocess.run(
            [sys.executable, "-m", "rl_zoo3.train", *words.split()], cwd=folder, capture_output=True, text=True
        )
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])


def skrl(env: str, way: str) -> Env:
    """Run random actions through skrl's wrapper, which its trainers step."""
    import torch
    from skrl.envs.wrappers.torch import wrap_env

    worlds = make(env, way)
    wrapped = wrap_env(worlds, verbose=False)
    wrapped.reset()
    for _ in range(STEPS):
        actions = 2 * torch.rand(wrapped.num_envs, wrapped.action_space.shape[0]) - 1
        *_, terminated, truncated, _ = wrapped.step(actions)
        if wrapped.num_envs > 1 or (terminated | truncated).any():
            wrapped.reset()
    return worlds


def torchrl(env: str, way: str) -> Env:
    """Run random actions by TorchRL's collector. Only with `same_step` does it need flat infos."""
    from torchrl.collectors import Collector
    from torchrl.envs import GymWrapper

    worlds = make(env, way, flat_infos=way == "same_step")
    frames = STEPS * (1 if way == "gymnasium.make" else WORLDS)
    wrapped = GymWrapper(worlds)
    for _ in Collector(wrapped, None, frames_per_batch=frames, total_frames=frames):
        pass
    return worlds


def imitation(env: str, way: str) -> Env:
    """Run episodes by imitation's rollouts, and cloning from them."""
    from imitation.algorithms.bc import BC
    from imitation.data import rollout
    from stable_baselines3.common.vec_env import DummyVecEnv

    plain, adapted = _for_stable_baselines(env, way)
    venv = DummyVecEnv([lambda: plain]) if way == "gymnasium.make" else adapted
    rng = np.random.default_rng(0)
    episodes = rollout.generate_trajectories(None, venv, rollout.make_sample_until(min_episodes=2 * WORLDS), rng)
    flat = rollout.flatten_trajectories(episodes)
    spaces = {"observation_space": venv.observation_space, "action_space": venv.action_space}
    BC(**spaces, demonstrations=flat, rng=rng, batch_size=4).train(n_batches=2, progress_bar=False)
    return plain


def minari(env: str, way: str) -> Env:
    """Run random actions, recorded with their infos by Minari's collector."""
    import minari

    worlds = make(env, way)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["MINARI_DATASETS_PATH"] = folder
        recorder = minari.DataCollector(worlds, record_infos=True)
        recorder.reset(seed=0)
        for _ in range(STEPS):
            *_, terminated, truncated, _ = recorder.step(recorder.action_space.sample())
            if terminated or truncated:
                recorder.reset()
        recorder.create_dataset("armctl/trial-v0", algorithm_name="random", code_permalink="-", author="-")
    return worlds


LEARNERS: dict[str, Learner] = {
    "Gymnasium alone, as CleanRL": gymnasium_alone,
    "Stable-Baselines3 PPO": _on_policy("stable_baselines3", "PPO"),
    "Stable-Baselines3 SAC with HER": hindsight,
    "sb3-contrib RecurrentPPO": _on_policy("sb3_contrib", "RecurrentPPO", "Lstm"),
    "SBX PPO": _on_policy("sbx", "PPO"),
    "rl-zoo3 PPO": zoo,
    "skrl": skrl,
    "TorchRL": torchrl,
    "imitation BC": imitation,
    "Minari DataCollector": minari,
}
ITS_OWN = "no: makes its worlds itself, from the id"
ONE_WORLD = "no: takes one world"
NUMPY = "no: cannot be installed beside NumPy 2, which armctl needs"
LABELS: Mapping[str, Mapping[str, str]] = {
    "rl-zoo3 PPO": dict.fromkeys(WAYS[1:], ITS_OWN),
    "skrl": {"next_step": "steps, but would learn from the steps that only reset"},
    "Minari DataCollector": dict.fromkeys(WAYS[1:], ONE_WORLD),
    "PufferLib": dict.fromkeys(WAYS, NUMPY),
}
"""Reasons that no error tells, in place of a trial."""


def cell(learner: str, env: str, way: str) -> str:
    """Return the result of a combination."""
    if way in LABELS.get(learner, {}):
        return LABELS[learner][way]
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            result = LEARNERS[learner](env, way)
    except Exception as error:
        return f"no: {in_short(error)}"
    if result is None:
        return "works"
    [counter] = getattr(result.unwrapped, "worlds", result.unwrapped).observers
    return "works" if (counter.counts > LIMIT).all() else "no: its worlds stay in an episode that has ended"


def in_short(error: Exception) -> str:
    """Return an error's first sentence."""
    text = " ".join(str(error).split()) or type(error).__name__
    return textwrap.shorten(text.split(". ")[0], LONGEST, placeholder=" ...")


def row(learner: str, env: str) -> list[str]:
    """Return a learner's cells in an environment."""
    return [cell(learner, env, way).replace("|", "/") for way in WAYS]


def _tried(learner: str, envs: list[str]) -> dict[str, list[str]]:
    """Return a learner's cells in each environment, from a process of its own."""
    command = [sys.executable, "-W", "ignore", __file__, "--only", learner, "--raw"]
    command += [word for env in envs for word in ("--env", env)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"RL_WARNINGS": "False"})
    if done.returncode:
        raise SystemExit(f"{learner}: {done.stderr[-2000:]}")
    rows: dict[str, list[str]] = json.loads(done.stdout.splitlines()[-1])
    return rows


def main(only: str = "", env: list[str] | None = None, raw: bool = False) -> None:
    """Try all combinations, and print a table; environments with the same cells share a row."""
    envs = env or [name for name in environment_names() if name.startswith("armctl/")]
    learners = [name for name in dict.fromkeys((*LEARNERS, *LABELS)) if only.lower() in name.lower()]
    if raw:
        print("\n" + json.dumps({env_id: row(learners[0], env_id) for env_id in envs}))
        return
    table = markdown_table("learner", "environments", *(f"`{way}`" for way in WAYS))
    for learner in learners:
        envs_by_cells: dict[tuple[str, ...], list[str]] = {}
        for env_id, cells in _tried(learner, envs).items():
            envs_by_cells.setdefault(tuple(cells), []).append(env_id.removeprefix("armctl/").removesuffix("-v0"))
        for columns, names in envs_by_cells.items():
            table.add_row(learner, "all" if len(names) == len(envs) else ", ".join(names), *columns)
    show(table, width=1_000)


if __name__ == "__main__":
    typer.run(main)
