"""Plays N episodes of M steps, prints states, actions and rewards, and records a video."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import imageio
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from armctl.envs import batch_of_one, find_spec
from armctl.errors import ConfigurationError, ResultsError
from armctl.evaluation.rollouts import wrap_policy_errors
from armctl.policies import make_policy

Film = Callable[[NDArray[np.uint8]], None]


def run_episodes(
    policy: str,
    env: str,
    episodes: int,
    steps: int | None,
    seed: int,
    video: Path | None,
    watch: bool,
    env_options: Mapping[str, Any],
) -> bool:
    """Play episodes with one policy, and print each step. Returns False if interrupted.

    Raises `ConfigurationError`, `AgentFileError`, `PolicyFailed`, and `ResultsError` if the video cannot be written.
    """
    if watch and video:
        raise ConfigurationError("--watch and --video exclude each other: choose one")
    console = Console()
    world: Any = _make(env, steps, "human" if watch else "rgb_array" if video else None, env_options)
    actor = make_policy(policy, world)
    try:
        with _film(video, world.metadata["render_fps"], console) as film:
            for episode in range(episodes):
                console.rule(f"{policy}, episode {episode} of seed {seed}", align="left")
                _play(console, policy, actor, world, seed, episode, film, watch)
    except KeyboardInterrupt:
        console.print("Interrupted.")
        return False
    finally:
        world.close()
    return True


def _play(
    console: Console, name: str, actor: Any, world: Any, seed: int, episode: int, film: Film | None, watch: bool
) -> None:
    observation, info = world.reset(seed=seed, options={"episode": episode})
    total, step, finished = 0.0, 0, False
    with wrap_policy_errors(name, episode):
        actor.reset(np.zeros(1, dtype=np.int32))
    while not finished:
        if film:
            film(world.render())
        state = {part: value.copy() for part, value in world.unwrapped.task.observation_parts().items()}
        with wrap_policy_errors(name, episode):
            action = actor.act(batch_of_one(observation))[0]
            observation, reward, terminated, truncated, info = world.step(action)
        if watch:
            time.sleep(1 / world.metadata["render_fps"])
        _print_step(console, step, state | {"action": action[None]}, info["reward_terms"], float(reward))
        total, step, finished = total + float(reward), step + 1, terminated or truncated
    if film:
        for _ in range(world.metadata["render_fps"] // 2):
            film(world.render())
    console.print(f"[bold]{info['outcome']} after {step} steps, return {total:g}[/]\n")


def _make(
    env: str, steps: int | None, render_mode: str | None, env_options: Mapping[str, Any]
) -> gymnasium.Env[Any, Any]:
    options: dict[str, Any] = {**env_options, **({} if steps is None else {"max_episode_steps": steps})}
    if not isinstance(options.get("max_episode_steps", 1), int):
        raise ConfigurationError(f"max_episode_steps must be a whole number, not {options['max_episode_steps']!r}")
    return gymnasium.make(find_spec(env), render_mode=render_mode, **options)


def _print_step(
    console: Console, step: int, values: dict[str, NDArray[Any]], terms: dict[str, float], reward: float
) -> None:
    console.print(f"[bold]step {step}[/]")
    for name, value in values.items():
        console.print(f"  {name:<22}" + " ".join(f"{number:8.4f}" for number in value[0]), highlight=False)
    earned = ", ".join(f"{name} {value:g}" for name, value in terms.items())
    console.print(f"  {'reward':<22}{reward:8g}   ({earned})", highlight=False)


@contextmanager
def _film(video: Path | None, fps: int, console: Console) -> Iterator[Film | None]:
    """A function that appends frames to a video file; None without a file."""
    if video is None:
        yield None
        return
    try:
        video.parent.mkdir(parents=True, exist_ok=True)
        writer = imageio.get_writer(video, fps=fps)
    except (OSError, ValueError) as error:
        raise ResultsError(f"the video {video} cannot be written: {error}") from error
    frames = 0

    def film(frame: NDArray[np.uint8]) -> None:
        nonlocal frames
        frames += 1
        try:
            writer.append_data(frame)
        except OSError as error:
            raise ResultsError(f"the video {video} cannot be written: {error}") from error

    try:
        yield film
    finally:
        writer.close()
        console.print(f"{video}: {frames} frames")
