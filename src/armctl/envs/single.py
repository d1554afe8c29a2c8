"""Ordinary Gymnasium environment of one world."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike

from armctl.core.errors import InvalidAction
from armctl.envs.episodes import EpisodeVectorEnv, Infos
from armctl.envs.observations import action_numbers, one_of
from armctl.envs.pickling import MadeAgain
from armctl.envs.vector import GOAL_METHODS, RENDER_MODES, TaskVectorEnv
from armctl.tasks import Observations, Task


class TaskEnv(MadeAgain, gymnasium.Env[Any, Any]):
    """One world: the n = 1 view of a `TaskVectorEnv`, with the same options. Its infos have `outcome` as text, too.

    Give `max_episode_steps` to `gym.make`, whose `TimeLimit` wrapper truncates episodes; `outcome` is `running` then.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}

    def __init__(self, task: str | type[Task], *, render_mode: str | None = None, **options: Any) -> None:
        self.worlds = TaskVectorEnv(
            1, task=task, render_mode=render_mode, autoreset_mode=AutoresetMode.DISABLED, threads=1, **options
        )
        self.metadata = self.metadata | {"render_fps": self.worlds.metadata["render_fps"]}
        self.render_mode = render_mode
        self.observation_space = self.worlds.single_observation_space
        self.action_space = self.worlds.single_action_space
        for name in GOAL_METHODS:
            if hasattr(self.worlds, name):
                setattr(self, name, getattr(self.worlds, name))

    @property
    def task(self) -> Any:
        """The `Task`, with its robot and simulation."""
        return self.worlds.task

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start the next episode, or the first of `seed`, or episode `options["episode"]`."""
        super().reset(seed=seed)
        observations, infos = self.worlds.reset(seed=seed, options=options)
        if self.render_mode == "human":
            self.render()
        return one_of(observations, 0), self._info(infos)

    def step(self, action: ArrayLike) -> tuple[Observations, float, bool, bool, Infos]:
        """Make one control step. If the action is invalid, raises `InvalidAction` and steps nothing."""
        if self.worlds._finished[0]:
            raise gymnasium.error.ResetNeeded("the episode has ended, or none has begun: call reset() before step()")
        numbers = action_numbers(action)
        if numbers.shape != self.action_space.shape:
            raise InvalidAction(f"the action has shape {numbers.shape}; expected {self.action_space.shape}")
        observations, rewards, terminated, truncated, infos = self.worlds.step(numbers[None])
        if self.render_mode == "human":
            self.render()
        ends = bool(terminated[0]), bool(truncated[0])
        return one_of(observations, 0), float(rewards[0]), *ends, self._info(infos)

    def render(self) -> Any:
        """Return an image (height, width, 3), or None in the mode `human`."""
        frames = self.worlds.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Close the window and free graphics memory."""
        self.worlds.close()

    def _info(self, infos: Infos) -> Infos:
        return {"outcome": self.worlds.outcomes[infos["outcome_id"][0]], **_first(infos)}


@dataclass(frozen=True)
class OneWorld:
    """Knowledge of a controller of one world about an environment that was made of a task."""

    observation_space: gymnasium.spaces.Space[Any]
    action_space: gymnasium.spaces.Space[Any]
    task: Any
    spec: Any
    perceived: Callable[[], Any]
    """Source of the state for a controller that sees it: see `EpisodeVectorEnv.perceived`."""

    @classmethod
    def of(cls, worlds: EpisodeVectorEnv) -> "OneWorld":
        """Return what there is to say about any of these worlds."""
        return cls(
            worlds.single_observation_space, worlds.single_action_space, worlds.task, worlds.spec, worlds.perceived
        )


def _first(infos: Infos) -> Infos:
    """Return the first world's part of a vector environment's infos."""
    return {key: _first(value) if isinstance(value, dict) else value[0].item() for key, value in infos.items()}
