"""Demonstrations: whole episodes of a policy, played in many worlds at once."""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Observations
from armctl.envs import EpisodeVectorEnv, one_of
from armctl.envs.observations import stacked
from armctl.episodes.failures import unless_failed
from armctl.episodes.record import EpisodeResult
from armctl.policies import Policy
from armctl.rollout.loop import rollouts


@dataclass(frozen=True)
class Demonstration:
    """One episode of T control steps."""

    observations: Observations
    """(T + 1, ...), including the final one."""
    actions: NDArray[np.floating[Any]]
    """(T, ...), the demonstrator's actions, before clipping."""
    rewards: NDArray[np.float64]
    """(T,)"""
    terminated: bool
    """True if the episode terminated, False if it was truncated."""
    success: bool

    def __len__(self) -> int:
        return len(self.actions)


OBSERVATIONS = "observations"


def parts_of(observations: Observations) -> dict[str, NDArray[Any]]:
    """Return the arrays of observations by their names in a file: `observations`, or `observations/PART` for each."""
    if isinstance(observations, dict):
        return {f"{OBSERVATIONS}/{name}": values for name, values in observations.items()}
    return {OBSERVATIONS: observations}


def observations_of(parts: dict[str, NDArray[Any]]) -> Observations:
    """Return the observations of which these are the `parts_of`."""
    if OBSERVATIONS in parts:
        return parts[OBSERVATIONS]
    return {name.removeprefix(f"{OBSERVATIONS}/"): values for name, values in parts.items()}


class RecordingWorlds(gymnasium.vector.VectorWrapper[Any, Any, Any, Any, Any]):
    """Records the episodes of worlds without autoreset: `infos["recordings"]` are those that have ended, by world."""

    def __init__(self, env: EpisodeVectorEnv) -> None:
        super().__init__(env)
        self.labels: NDArray[np.floating[Any]] | None = None
        """(n, ...) recorded as the next actions, instead of those that are executed."""
        self._worlds, self.task, self.outcomes = env, env.task, env.outcomes
        self._observations: list[list[Any]] = [[] for _ in range(env.num_envs)]
        self._steps: list[list[Any]] = [[] for _ in range(env.num_envs)]
        self._open = np.zeros(env.num_envs, dtype=bool)

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Observations, dict[str, Any]]:
        """Start new episodes."""
        observations, infos = self.env.reset(seed=seed, options=options)
        began = (options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool))
        for i in np.flatnonzero(began):
            self._observations[i], self._steps[i] = [_copy(one_of(observations, int(i)))], []
        self._open |= began
        return observations, infos

    def step(self, actions: ArrayLike) -> tuple[Any, Any, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Make one control step in every world, and record it."""
        dtype = self._worlds.single_action_space.dtype
        actions = np.asarray(actions, dtype=dtype)  # what is recorded is what is executed
        labels = actions if self.labels is None else np.asarray(self.labels, dtype=dtype)
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        for i in np.flatnonzero(self._open):
            self._observations[i].append(_copy(one_of(observations, int(i))))
            self._steps[i].append((labels[i], rewards[i]))
        recordings: list[Demonstration | None] = [None] * self.num_envs
        for i in np.flatnonzero((terminated | truncated) & self._open):
            episode_actions, episode_rewards = zip(*self._steps[i], strict=True)
            recordings[i] = Demonstration(
                stacked(self._observations[i]), np.array(episode_actions), np.array(episode_rewards),
                bool(terminated[i]), bool(infos["is_success"][i]),
            )  # fmt: skip
            self._open[i] = False
        return observations, rewards, terminated, truncated, infos | {"recordings": recordings}


def demonstrate(
    policy: Policy,
    worlds: EpisodeVectorEnv,
    episodes: int | Sequence[int],
    seed: int,
    name: str = "policy",
    acting: Callable[[Observations, NDArray[Any]], NDArray[Any]] | None = None,
) -> Generator[tuple[EpisodeResult, Demonstration], None, None]:
    """Play episodes of `seed`, and yield each as it ends. `episodes` is how many, from 0 on, or their numbers.

    `acting`, a function of the observations and the policy's actions, returns actions to execute in place of the
    policy's; the recorded actions are still the policy's. `worlds` must have no autoreset (see `make_worlds`), and
    there should be no more of them than episodes. Raises `PolicyFailed` for the first episode in which the
    policy fails: it is no demonstration.
    """
    recorder: Any = RecordingWorlds(worlds)
    actor: Any = policy if acting is None else _Overridden(policy, acting, recorder)
    numbers = range(episodes) if isinstance(episodes, int) else episodes
    unknown = dict.fromkeys(numbers, np.nan)  # least lengths, which are not needed here
    for result in unless_failed(rollouts(actor, recorder, numbers, seed, name, unknown)):
        yield result, result.recording


class _Overridden:
    """Queries a policy, and executes what `acting` makes of its actions."""

    training_steps = 0

    def __init__(self, policy: Policy, acting: Callable[[Any, Any], NDArray[Any]], recorder: RecordingWorlds) -> None:
        self.sees, self.reset = policy.sees, policy.reset
        self._policy, self._acting, self._recorder = policy, acting, recorder

    def act(self, observations: Observations) -> NDArray[Any]:
        """Actions (n, ...)."""
        self._recorder.labels = self._policy.act(observations)
        return self._acting(observations, self._recorder.labels)


def _copy(observation: Any) -> Any:
    if isinstance(observation, dict):
        return {name: np.array(value) for name, value in observation.items()}
    return np.array(observation)
