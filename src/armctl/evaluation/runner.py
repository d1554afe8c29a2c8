"""The runner of old: N episodes of M steps, with states, actions and rewards for all to see, and on video."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from armctl.envs import RENDER_FPS
from armctl.errors import ConfigurationError, ResultsError
from armctl.policies import make_policy


def run_episodes(
    policy: str,
    env: str,
    episodes: int,
    steps: int | None,
    seed: int,
    video: Path | None,
    watch: bool,
    env_options: Mapping[str, Any],
) -> None:
    """Play episodes with one policy, and print each step.

    Raises `ConfigurationError`, `AgentFileError`, or `ResultsError` for a video that cannot be written.
    """
    console = Console()
    world: Any = _make(env, steps, "human" if watch else "rgb_array" if video else None, env_options)
    actor = make_policy(policy, world)
    frames: list[NDArray[np.uint8]] = []
    try:
        for episode in range(episodes):
            observation, info = world.reset(seed=seed, options={"episode": episode})
            actor.reset(np.zeros(1, dtype=np.int32))
            console.rule(f"{policy}, episode {episode} of seed {seed}", align="left")
            total, step, finished = 0.0, 0, False
            while not finished:
                if video:
                    frames.append(world.render())
                action = actor.act(observation[None])[0]
                state = {name: part.copy() for name, part in world.unwrapped.task.parts().items()}
                observation, reward, terminated, truncated, info = world.step(action)
                if watch:
                    time.sleep(1 / RENDER_FPS)
                _print_step(console, step, state | {"action": action[None]}, info["reward_terms"], float(reward))
                total, step, finished = total + float(reward), step + 1, terminated or truncated
            if video:
                frames += [world.render()] * (RENDER_FPS // 2)
            console.print(f"[bold]{info['outcome']} after {step} steps, return {total:g}[/]\n")
    except KeyboardInterrupt:
        console.print("Interrupted.")
    finally:
        world.close()
        if video and frames:
            _save(video, frames)
            console.print(f"{video}: {len(frames)} frames")


def _make(
    env: str, steps: int | None, render_mode: str | None, env_options: Mapping[str, Any]
) -> gymnasium.Env[Any, Any]:
    options: dict[str, Any] = {**env_options, **({} if steps is None else {"max_episode_steps": steps})}
    try:
        return gymnasium.make(env, render_mode=render_mode, **options)
    except gymnasium.error.Error as error:
        raise ConfigurationError(f"no environment {env!r}: {error}") from error


def _print_step(
    console: Console, step: int, values: dict[str, NDArray[Any]], terms: dict[str, float], reward: float
) -> None:
    console.print(f"[bold]step {step}[/]")
    for name, value in values.items():
        console.print(f"  {name:<22}" + " ".join(f"{number:8.4f}" for number in value[0]), highlight=False)
    earned = ", ".join(f"{name} {value:g}" for name, value in terms.items())
    console.print(f"  {'reward':<22}{reward:8g}   ({earned})", highlight=False)


def _save(video: Path, frames: list[NDArray[np.uint8]]) -> None:
    try:
        video.parent.mkdir(parents=True, exist_ok=True)
        imageio.imwrite(video, np.array(frames), fps=RENDER_FPS)
    except (OSError, ValueError) as error:
        raise ResultsError(f"the video {video} could not be written: {error}") from error
