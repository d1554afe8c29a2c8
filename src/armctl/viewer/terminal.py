"""Plays N episodes of M steps, prints states, actions and rewards, and records them for later."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from armctl.core.arrays import Observations
from armctl.core.console import PlainConsole
from armctl.core.errors import ConfigurationError
from armctl.envs import EpisodeVectorEnv
from armctl.envs.observations import one_of
from armctl.viewer.recording import Film, check_video, recording
from armctl.viewer.stage import Stage


class StepLog(Protocol):
    """Records control steps. An episode is a number of `decision` and `rewards`, and then `end`."""

    def decision(self, observations: Observations, actions: NDArray[Any], plans: Mapping[str, NDArray[Any]]) -> None:
        """Record what a policy sees, does and plans, before that has any effect."""

    def rewards(self, terms: Mapping[str, float], reward: float) -> None:
        """Record the rewards of the control step, by term if these are known."""

    def end(self, observations: Observations, ending: str) -> None:
        """Record the last state of an episode, and how it ended."""


LogOpener = Callable[[EpisodeVectorEnv, Callable[[Path, int], object]], AbstractContextManager[StepLog]]
"""Opener of a log of the first world's steps, such as Rerun's; it calls its second argument with file and steps."""

MAX_NUMBERS = 200
"""Largest size of an array whose numbers are printed."""


@dataclass(frozen=True)
class Outputs:
    """Window and files that show episodes besides the terminal."""

    video: Path | None = None
    watch: bool = False
    """Show them in a window, in real time."""
    log: LogOpener | None = None

    def __post_init__(self) -> None:
        if self.watch and self.video:
            raise ConfigurationError("--watch and --video exclude each other: choose one")
        if self.video:
            check_video(self.video)

    @property
    def render_mode(self) -> str | None:
        """Render mode of the environment."""
        return "human" if self.watch else "rgb_array" if self.video else None

    def open_video(self, fps: int, console: PlainConsole) -> AbstractContextManager[Film | None]:
        """Return a function that appends frames to the video; None without one."""
        if (video := self.video) is None:
            return nullcontext()
        return recording(video, fps, lambda frames: console.print(f"{video}: {frames} frames", soft_wrap=True))

    def open_log(self, worlds: EpisodeVectorEnv, console: PlainConsole) -> AbstractContextManager[StepLog | None]:
        """Return a log of control steps; None if none is asked for."""
        if self.log is None:
            return nullcontext()
        return self.log(worlds, lambda file, steps: console.print(f"{file}: {_steps(steps)}", soft_wrap=True))


def run_episodes(
    policy: str,
    env: str,
    episodes: range,
    seed: int,
    *,
    steps: int | None = None,
    env_options: Mapping[str, Any] | None = None,
    outputs: Outputs | None = None,
    policy_seed: int | None = None,
) -> bool:
    """Play episodes with one policy, of at most so many steps, and print each step. Returns False if interrupted.

    The policy's own random numbers come from `policy_seed`, or else from a new secret.

    Raises `ConfigurationError`, `AgentFileError`, `PolicyFailed`, and `ResultsError` if the video or
    the log cannot be written.
    """
    console, outputs = PlainConsole(), outputs or Outputs()
    options = {**(env_options or {}), **({} if steps is None else {"max_episode_steps": steps})}
    try:
        stage = Stage(policy, env, seed, episodes[0], options, outputs.render_mode, policy_seed)
        fps: int = stage.worlds.metadata["render_fps"]
        with (
            closing(stage),
            outputs.open_video(fps, console) as film,
            outputs.open_log(stage.worlds, console) as log,
        ):

            def show() -> None:
                if film:
                    film(stage.worlds.render()[0])
                if outputs.watch:
                    stage.worlds.render()
                    time.sleep(1 / fps)

            for episode in episodes:
                console.rule(f"{policy}, episode {episode} of seed {seed}", align="left")
                if episode != episodes[0]:
                    stage.play(policy, seed, episode)
                _play(console, stage, show, log, steps)
                for _ in range(fps // 2 if film else 0):
                    show()
    except KeyboardInterrupt:
        console.print("Interrupted.")
        return False
    return True


def _play(
    console: PlainConsole, stage: Stage, show: Callable[[], None], log: StepLog | None, max_steps: int | None
) -> None:
    """Play and print the episode that has begun, of at most `max_steps`."""
    total = 0.0
    while stage.status.outcome is None:
        show()
        state = dict(_leaves("", one_of(stage.task.observation_parts(), 0)))
        actions = stage.decide()
        if log:
            log.decision(stage.observations, actions, stage.plans())
        terms, reward = stage.execute(actions)
        if log:
            log.rewards(terms, reward)
        _print_step(console, stage.status.steps - 1, state | {"action": actions[0]}, terms, reward)
        total += reward
    status = stage.status
    stopped = status.truncated and status.steps == max_steps  # the environment itself would have gone on
    ending = f"{'stopped' if stopped else status.outcome} after {_steps(status.steps)}{', as asked' if stopped else ''}"
    if log:
        log.end(stage.observations, f"{status.policy}, episode {status.episode} of seed {status.seed}: {ending}")
    console.print(Text(f"{ending}, return {total:g}", "bold"), end="\n\n")


def _leaves(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield copies of the arrays of an observation, by names such as `camera/0`."""
    if isinstance(value, (dict, tuple, list)):
        for key, part in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _leaves(f"{name}/{key}".removeprefix("/"), part)
    else:
        yield name, np.array(value)


def _steps(count: int) -> str:
    return "1 step" if count == 1 else f"{count} steps"


def _print_step(
    console: PlainConsole, step: int, values: dict[str, Any], terms: dict[str, float], reward: float
) -> None:
    console.print(Text(f"step {step}", "bold"))
    for name, value in values.items():
        console.print(f"  {name:<22}" + _numbers(value), highlight=False)
    rewards = ", ".join(f"{name} {value:g}" for name, value in terms.items())
    console.print(f"  {'reward':<22}{reward:8g}" + (f"   ({rewards})" if rewards else ""), highlight=False)


def _numbers(value: Any) -> str:
    array = np.asarray(value)
    if array.size > MAX_NUMBERS:
        return f"{array.dtype} array of shape {array.shape}"
    return " ".join(f"{number:8.4f}" if array.dtype.kind == "f" else f"{number!s:>8}" for number in array.ravel())
