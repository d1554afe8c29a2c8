"""Plays N episodes of M steps, prints states, actions and rewards, and records them for later."""

import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from armctl.core.console import PlainConsole
from armctl.core.errors import ConfigurationError
from armctl.envs import EpisodeVectorEnv
from armctl.policies import Plans, Policy, WorldsByInterface, make_policy
from armctl.rollout.rollouts import wrap_environment_errors, wrap_policy_errors
from armctl.tasks import Observations
from armctl.viewer.recording import Film, check_video, recording


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


def run_episodes(
    policy: str,
    env: str,
    episodes: int,
    steps: int | None,
    seed: int,
    video: Path | None,
    watch: bool,
    env_options: Mapping[str, Any],
    first: int = 0,
    log: LogOpener | None = None,
    policy_seed: int | None = None,
) -> bool:
    """Play episodes with one policy, from number `first` on, and print each step. Returns False if interrupted.

    The policy's own random numbers come from `policy_seed`, or else from a new secret.

    Raises `ConfigurationError`, `AgentFileError`, `PolicyFailed`, and `ResultsError` if the video or
    the log cannot be written.
    """
    if watch and video:
        raise ConfigurationError("--watch and --video exclude each other: choose one")
    if video:
        check_video(video)
    console = PlainConsole()
    interfaces = _make(env, steps, "human" if watch else "rgb_array" if video else None, env_options)
    try:
        worlds = interfaces.of(policy)
        actor = make_policy(policy, worlds, policy_seed=policy_seed)
        with _film(video, worlds.metadata["render_fps"], console) as film, _log(log, worlds, console) as step_log:
            for episode in range(first, first + episodes):
                console.rule(f"{policy}, episode {episode} of seed {seed}", align="left")
                _play(console, policy, actor, worlds, seed, episode, film, step_log, watch, steps)
    except KeyboardInterrupt:
        console.print("Interrupted.")
        return False
    finally:
        interfaces.close()
    return True


def _play(
    console: PlainConsole,
    name: str,
    actor: Policy,
    worlds: Any,
    seed: int,
    episode: int,
    film: Film | None,
    log: StepLog | None,
    watch: bool,
    max_steps: int | None,
) -> None:
    """Play and print one episode, of at most `max_steps`."""

    def show() -> None:
        if film:
            film(worlds.render()[0])
        if watch:
            worlds.render()
            time.sleep(1 / worlds.metadata["render_fps"])

    observations, _ = worlds.reset(seed=[seed], options={"episode": [episode]})
    total, step, terminated, truncated = 0.0, 0, [False], [False]
    with wrap_policy_errors(name, episode):
        actor.reset(np.zeros(1, dtype=np.int32))
    while not (terminated[0] or truncated[0]):
        show()
        state = {part: np.array(values[0]) for part, values in worlds.task.observation_parts().items()}
        with wrap_policy_errors(name, episode):
            actions = actor.act(observations)
            plans = actor.plans(0) if log and isinstance(actor, Plans) else {}
        if log:
            log.decision(observations, actions, plans)
        with wrap_environment_errors(name, episode):
            observations, rewards, terminated, truncated, infos = worlds.step(actions)
        terms = {term: float(rewards_of_term[0]) for term, rewards_of_term in infos["reward_terms"].items()}
        if log:
            log.rewards(terms, float(rewards[0]))
        _print_step(console, step, state | {"action": actions[0]}, terms, float(rewards[0]))
        total, step = total + float(rewards[0]), step + 1
    if film:
        for _ in range(worlds.metadata["render_fps"] // 2):
            show()
    stopped = truncated[0] and not terminated[0] and step == max_steps  # the environment itself would have gone on
    ending = worlds.outcomes[infos["outcome_id"][0]]
    ending = f"stopped after {_steps(step)}, as asked" if stopped else f"{ending} after {_steps(step)}"
    if log:
        log.end(observations, f"{name}, episode {episode} of seed {seed}: {ending}")
    console.print(Text(f"{ending}, return {total:g}", "bold"), end="\n\n")


def _steps(count: int) -> str:
    return "1 step" if count == 1 else f"{count} steps"


def _make(env: str, steps: int | None, render_mode: str | None, env_options: Mapping[str, Any]) -> WorldsByInterface:
    options: dict[str, Any] = {**env_options, **({} if steps is None else {"max_episode_steps": steps})}
    return WorldsByInterface(env, 1, options, render_mode=render_mode)


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


def _film(video: Path | None, fps: int, console: PlainConsole) -> AbstractContextManager[Film | None]:
    """Return a function that appends frames to a video file; None without a file."""
    if video is None:
        return nullcontext()
    return recording(video, fps, lambda frames: console.print(f"{video}: {frames} frames", soft_wrap=True))


def _log(log: LogOpener | None, worlds: Any, console: PlainConsole) -> AbstractContextManager[StepLog | None]:
    """Open a log of control steps; None if none is asked for."""
    if log is None:
        return nullcontext()
    return log(worlds, lambda file, steps: console.print(f"{file}: {_steps(steps)}", soft_wrap=True))
