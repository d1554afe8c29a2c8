"""Ordinary Gymnasium environment of one world."""

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
        return one_of(observations, 0), {"outcome": self.worlds.outcomes[infos["outcome_id"][0]], **_first(infos)}

    def step(self, action: ArrayLike) -> tuple[Observations, float, bool, bool, Infos]:
        """Make one control step. If the action is invalid, raises `InvalidAction` and steps nothing."""
        if self.worlds._finished[0]:
            raise gymnasium.error.ResetNeeded("the episode has ended, or none has begun: call reset() before step()")
        numbers = action_numbers(action)
        if numbers.shape != self.action_space.shape:
            raise InvalidAction(f"the action has shape {numbers.shape}; expected {self.action_space.shape}")
        worlds, results = self.worlds, self.worlds._results
        worlds._advance(worlds._finite(numbers[None]))
        observation = one_of(worlds._observe(), 0)
        if self.render_mode == "human":
            self.render()
        terminated, truncated, success = results.ends[:, 0].tolist()
        outcome, terms = results.outcomes.item(0), results.terms[:, 0].tolist()
        infos = {"outcome": worlds.outcomes[outcome], **worlds._step_infos(success, outcome, terms)}
        return observation, results.rewards.item(0), terminated, truncated, infos | _first(worlds._task_info())

    def render(self) -> Any:
        """Return an image (height, width, 3), or None in the mode `human`."""
        frames = self.worlds.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Close the window and free graphics memory."""
        self.worlds.close()


class OneWorld:
    """World number `world` of an environment that was made of a task, for a controller that sees the state.

    It may only read. In the task's arrays, (n, ...), the row `world` is its own.
    """

    def __init__(self, worlds: EpisodeVectorEnv, world: int) -> None:
        self.world = world
        self.observation_space, self.action_space = worlds.single_observation_space, worlds.single_action_space
        self.task, self.spec, self.max_episode_steps = worlds.task, worlds.spec, worlds.max_episode_steps
        self.control_period, self.idle_action = worlds.control_period, worlds.idle_action
        self.perceived, self.model = worlds.perceived, worlds.model
        self._preview, self._steps = worlds.preview, worlds.clock

    @property
    def unwrapped(self) -> "OneWorld":
        """Itself: nothing wraps it."""
        return self

    def control_step(self) -> int:
        """Return how many control steps the current episode has taken."""
        return int(self._steps[self.world])

    def preview(self, name: str) -> Any:
        """Return what a policy with this foresight knows of the episode: see `EpisodeVectorEnv.preview`."""
        return self._preview(name, self.world)


def _first(infos: Infos) -> Infos:
    """Return the first world's part of a vector environment's infos."""
    return {key: _first(value) if isinstance(value, dict) else value.item(0) for key, value in infos.items()}
