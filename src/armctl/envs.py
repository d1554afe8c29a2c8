"""Gymnasium's face of the tasks: `gym.make_vec` steps n worlds at once, `gym.make` is the view of one.

An episode is fixed by (environment id and options, seed, episode number) alone. World i of a vector environment that
was reset with `seed` plays the episodes of a single environment that was reset with `seed + i`, bit for bit.
"""

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Protocol

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from armctl.disturbances import disturbed, stream
from armctl.errors import ConfigurationError, InvalidAction, unknown_name
from armctl.simulation.rendering import Camera, Window
from armctl.tasks import (
    BridgeOptions,
    BridgeTask,
    ReachMovingOptions,
    ReachMovingTask,
    ReachObstaclesOptions,
    ReachObstaclesTask,
    ReachOptions,
    ReachTask,
)
from armctl.tasks.task import OUTCOME_LABELS, SUCCESSES, Observations, Outcome, Task

Array = NDArray[np.float64]
Infos = dict[str, Any]

RENDER_MODES = ("rgb_array", "human")
RENDER_FPS = 25


class Observer(Protocol):
    """Is told of all that happens in the worlds, states that an autoreset replaces at once included."""

    def began(self, ids: NDArray[np.int32]) -> None:
        """Worlds `ids` have begun a new episode."""

    def stepped(self, awake: NDArray[np.bool_]) -> None:
        """One decision later in the worlds that are `awake` (n,); no world has been reset yet."""


class TaskVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """n worlds of one task.

    Args:
        num_envs: number of worlds.
        max_episode_steps: decisions until an episode is truncated; None: never.
        render_mode: `rgb_array` (pictures of all worlds), `human` (a window on the first), or None.
        autoreset_mode: what follows an episode's end: a new one on the next step (`next_step`), on the same step
            (`same_step`, with `infos["final_obs"]` and `infos["final_info"]`), or none (`disabled`: the world stands
            still until a `reset` whose `options["reset_mask"]` picks it).
        threads: threads to step the worlds on; 0 for all cores.
        disturbances: levels by name, such as `{"noise": 0.01, "payload": 2.0}`; see `armctl.disturbances`.
        **options: the task's options, such as `armctl.tasks.ReachOptions`.

    `reset(options={"episode": k})` starts at episode number k of the seed (an int, or one for each world) instead of 0.

    """

    metadata: dict[str, Any] = {
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    task: Task
    options_type: ClassVar[type[Any]]
    task_type: ClassVar[type[Any]]
    """Makes the `Task` for n worlds, with options, on so many threads."""
    single_observation_space: gymnasium.spaces.Space[Any]
    single_action_space: gymnasium.spaces.Box

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 0,
        disturbances: Mapping[str, float] = MappingProxyType({}),
        **options: Any,
    ) -> None:
        self.num_envs = _at_least_one("num_envs", num_envs)
        self.max_episode_steps = (
            None if max_episode_steps is None else _at_least_one("max_episode_steps", max_episode_steps)
        )
        if render_mode not in (None, *RENDER_MODES):
            raise unknown_name("render_mode", render_mode, RENDER_MODES)
        if not isinstance(threads, int) or threads < 0:
            raise ConfigurationError(f"threads is a whole number, 0 for all cores, not {threads!r}")
        self.render_mode = render_mode
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.metadata = self.metadata | {"autoreset_mode": self.autoreset_mode}
        self.task = self.task_type(self.num_envs, make_options(self.options_type, options), threads)
        self.disturbances = disturbed(self.task, disturbances)
        self.single_observation_space = self.task.observation_space
        self.single_action_space = self.task.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seeds = np.zeros(num_envs, dtype=np.int64)
        self._episodes = np.full(num_envs, -1)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._finished = np.ones(num_envs, dtype=bool)
        self._seeded = False
        self._viewer: Camera | Window | None = None
        self.observers: list[Observer] = []

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Start new episodes: in all worlds, or in those of `options["reset_mask"]` (n,) bool.

        `seed` starts world i at episode 0 of seed + i (or of seed[i]); without it, worlds go on to their next episode.
        """
        options = options or {}
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, dtype=bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise ConfigurationError(f"reset_mask is a bool array ({self.num_envs},), not {mask.dtype} {mask.shape}")
        if seed is None and not self._seeded:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        seeds = None if seed is None else self._whole_numbers("seed", seed)
        numbers = self._whole_numbers("episode", options["episode"]) if "episode" in options else None
        if seeds is not None:
            seeds = seeds if isinstance(seed, list) else seeds + np.arange(self.num_envs)
            super().reset(seed=int(seeds[0]))
            self._seeds[mask] = seeds[mask]
            self._episodes[mask] = -1
            self._seeded = True
        if numbers is not None:
            self._episodes[mask] = numbers[mask] - 1
        self._begin(np.flatnonzero(mask))
        return self._observe(), self.task.details()

    def step(self, actions: ArrayLike) -> tuple[Observations, Array, NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Make one decision in every world. Raises `InvalidAction`, and steps nothing, if an action is unusable."""
        commands = self._checked(actions)
        idle = self._finished
        restart = np.flatnonzero(idle) if idle.any() else None
        awake = None if restart is None else np.flatnonzero(~idle).astype(np.int32)
        for disturbance in self.disturbances.values():
            commands = disturbance.command(commands)
        self.task.command(commands)
        self.task.advance(awake)
        self._steps += 1
        ledger = self.task.score()
        outcome = self.task.outcome()
        if restart is not None:
            outcome[restart] = Outcome.TIMEOUT
        terminated = outcome != Outcome.TIMEOUT
        truncated = np.zeros(self.num_envs, dtype=bool)
        if self.max_episode_steps is not None:
            truncated = ~terminated & (self._steps >= self.max_episode_steps)
        if restart is not None:
            truncated[restart] = False
            for term in ledger.values():
                term[restart] = 0.0
        rewards = sum(ledger.values(), start=np.zeros(self.num_envs))
        finished = terminated | truncated
        infos: Infos = {
            "is_success": SUCCESSES[outcome],
            "outcome": OUTCOME_LABELS[outcome],
            "reward_terms": ledger,
            **self.task.details(),
        }
        for observer in self.observers:
            observer.stepped(~idle)
        self._finished = finished
        if self.autoreset_mode is AutoresetMode.NEXT_STEP and restart is not None:
            self._begin(restart)
            infos |= self.task.details()
        elif self.autoreset_mode is AutoresetMode.DISABLED and restart is not None:
            self._finished = finished | idle
        observations = self._observe()
        if self.autoreset_mode is AutoresetMode.SAME_STEP and finished.any():
            infos |= {
                "final_obs": observations,
                "_final_obs": finished,
                "final_info": infos | {f"_{key}": finished for key in infos},
                "_final_info": finished,
            }
            ended = np.flatnonzero(finished).astype(np.int32)
            self._begin(ended)
            infos |= self.task.details()
            observations = _replaced(observations, ended, self._observe(ended))
        return observations, rewards, terminated, truncated, infos

    def render(self) -> Any:
        """Pictures (height, width, 3) of all worlds as a tuple; None in the mode `human`, which shows the first."""
        simulation = self.task.simulation
        if self.render_mode is None:
            raise ConfigurationError("nothing to render: make the environment with render_mode='rgb_array' or 'human'")
        if self._viewer is None:
            human = self.render_mode == "human"
            self._viewer = Window(simulation.model) if human else Camera(simulation.model, self.task.camera)
        if isinstance(self._viewer, Window):
            self._viewer.show(simulation.data(0))
            return None
        return tuple(self._viewer.picture(simulation.data(i)) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window and give graphics memory back."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    @property
    def seeds(self) -> NDArray[np.int64]:
        """Seed of each world's present episode, (n,)."""
        return self._seeds.copy()

    @property
    def episodes(self) -> NDArray[np.int64]:
        """Number of each world's present episode under its seed, (n,)."""
        return self._episodes.copy()

    def _begin(self, ids: NDArray[np.integer[Any]]) -> None:
        self._episodes[ids] += 1
        self._steps[ids] = 0
        self._finished[ids] = False
        rngs = [np.random.default_rng((seed, k)) for seed, k in zip(self._seeds[ids], self._episodes[ids], strict=True)]
        worlds = ids.astype(np.int32)
        for name, disturbance in self.disturbances.items():
            for i in worlds:
                disturbance.rngs[i] = stream(name, int(self._seeds[i]), int(self._episodes[i]))
            disturbance.begin(worlds)
        self.task.reset(worlds, rngs)
        for observer in self.observers:
            observer.began(worlds)

    def _observe(self, ids: NDArray[np.int32] | None = None) -> Observations:
        observations = self.task.observe(ids)
        for disturbance in self.disturbances.values():
            observations = disturbance.observe(observations, slice(None) if ids is None else ids)
        return observations

    def _whole_numbers(self, name: str, given: Any) -> NDArray[np.int64]:
        numbers = np.asarray(given)
        usable = numbers.shape in ((), (self.num_envs,)) and numbers.dtype.kind in "iu"
        if not usable or (numbers < 0).any() or (numbers >= 2**62).any():
            raise ConfigurationError(f"{name} is a whole number from 0 on, or {self.num_envs} of them, not {given!r}")
        return np.broadcast_to(numbers, self.num_envs).astype(np.int64)

    def _checked(self, actions: ArrayLike) -> Array:
        if not self._seeded:
            raise gymnasium.error.ResetNeeded("call reset() before the first step()")
        checked = _numbers(actions)
        if checked.shape != self.action_space.shape:
            raise InvalidAction(f"actions have shape {checked.shape}; expected {self.action_space.shape}")
        if not np.isfinite(checked).all():
            worlds = np.flatnonzero(~np.isfinite(checked).reshape(self.num_envs, -1).all(axis=1))
            raise InvalidAction(f"action {checked[worlds[0]]} of world {worlds[0]} is not finite; no world was stepped")
        return checked


class TaskEnv(gymnasium.Env[Any, Any]):
    """One world: the n = 1 view of a `TaskVectorEnv`, with the same options.

    `max_episode_steps` is given to `gym.make`, whose `TimeLimit` wrapper truncates.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES), "render_fps": RENDER_FPS}
    vector_type: ClassVar[type[TaskVectorEnv]]

    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:
        self.worlds = self.vector_type(
            1, render_mode=render_mode, autoreset_mode=AutoresetMode.DISABLED, threads=1, **options
        )
        self.render_mode = render_mode
        self.observation_space = self.worlds.single_observation_space
        self.action_space = self.worlds.single_action_space

    @property
    def task(self) -> Task:
        """The task, with its robot and simulation."""
        return self.worlds.task

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start the next episode, or the first of `seed`, or episode `options["episode"]`."""
        super().reset(seed=seed)
        observations, infos = self.worlds.reset(seed=seed, options=options)
        if self.render_mode == "human":
            self.render()
        return one_of(observations, 0), _first(infos)

    def step(self, action: ArrayLike) -> tuple[Observations, float, bool, bool, Infos]:
        """Make one decision. Raises `InvalidAction`, and steps nothing, if the action is unusable."""
        if self.worlds._finished[0]:
            raise gymnasium.error.ResetNeeded("the episode has ended, or none has begun: call reset() before step()")
        given = _numbers(action)
        if given.shape != self.action_space.shape:
            raise InvalidAction(f"the action has shape {given.shape}; expected {self.action_space.shape}")
        observations, rewards, terminated, truncated, infos = self.worlds.step(given[None])
        if self.render_mode == "human":
            self.render()
        return one_of(observations, 0), float(rewards[0]), bool(terminated[0]), bool(truncated[0]), _first(infos)

    def render(self) -> Any:
        """Picture (height, width, 3), or None in the mode `human`."""
        frames = self.worlds.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Close the window and give graphics memory back."""
        self.worlds.close()


def make_options(options_type: type[Any], options: Mapping[str, Any]) -> Any:
    """Options dataclass from keywords; raises `ConfigurationError` for a keyword that it has not."""
    names = [field.name for field in dataclasses.fields(options_type)]
    for name in options:
        if name not in names:
            raise unknown_name("option", name, [*names, "max_episode_steps", "render_mode", "disturbances"])
    return options_type(**options)


def one_of(observations: Observations, world: int) -> Any:
    """What one world observes."""
    if isinstance(observations, dict):
        return {name: values[world] for name, values in observations.items()}
    return observations[world]


def _replaced(observations: Observations, ids: NDArray[np.int32], new: Observations) -> Observations:
    """Observations with those of worlds `ids` replaced by new ones."""
    if isinstance(observations, dict):
        assert isinstance(new, dict)
        return {name: _replaced_rows(values, ids, new[name]) for name, values in observations.items()}
    assert isinstance(new, np.ndarray)
    return _replaced_rows(observations, ids, new)


def _replaced_rows(values: NDArray[Any], ids: NDArray[np.int32], new: NDArray[Any]) -> NDArray[Any]:
    values = values.copy()
    values[ids] = new
    return values


def batch_of_one(observation: Any) -> Observations:
    """One world's observation as a batch."""
    if isinstance(observation, dict):
        return {name: np.asarray(value)[None] for name, value in observation.items()}
    return np.asarray(observation)[None]


def _first(infos: Infos) -> Infos:
    """The first world's share of a vector environment's infos."""
    return {key: _first(value) if isinstance(value, dict) else value[0].item() for key, value in infos.items()}


def _numbers(actions: ArrayLike) -> Array:
    try:
        return np.array(actions, dtype=float)
    except (TypeError, ValueError) as error:
        raise InvalidAction(f"an action is an array of numbers, not {actions!r}") from error


def _at_least_one(name: str, value: int) -> int:
    if not isinstance(value, (int, np.integer)) or value < 1:
        raise ConfigurationError(f"{name} is a whole number from 1 on, not {value!r}")
    return int(value)


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    if isinstance(mode, AutoresetMode):
        return mode
    if mode.upper() not in AutoresetMode.__members__:
        raise unknown_name("autoreset_mode", mode, [name.lower() for name in AutoresetMode.__members__])
    return AutoresetMode[mode.upper()]


class ArmReachVectorEnv(TaskVectorEnv):
    """`gym.make_vec("armctl/ArmReach-v0", num_envs=n, **options)`; options in `armctl.tasks.ReachOptions`."""

    task: ReachTask
    options_type: ClassVar[type[Any]] = ReachOptions
    task_type: ClassVar[type[Any]] = ReachTask


class ArmReachEnv(TaskEnv):
    """`gym.make("armctl/ArmReach-v0", **options)`; options in `armctl.tasks.ReachOptions`."""

    vector_type = ArmReachVectorEnv


class ArmReachMovingVectorEnv(ArmReachVectorEnv):
    """`gym.make_vec("armctl/ArmReachMoving-v0", num_envs=n, **options)`: `armctl.tasks.ReachMovingOptions`."""

    task: ReachMovingTask
    options_type = ReachMovingOptions
    task_type = ReachMovingTask


class ArmReachMovingEnv(TaskEnv):
    """`gym.make("armctl/ArmReachMoving-v0", **options)`; options in `armctl.tasks.ReachMovingOptions`."""

    vector_type = ArmReachMovingVectorEnv


class ArmReachObstaclesVectorEnv(ArmReachVectorEnv):
    """`gym.make_vec("armctl/ArmReachObstacles-v0", num_envs=n, **options)`: `armctl.tasks.ReachObstaclesOptions`."""

    task: ReachObstaclesTask
    options_type = ReachObstaclesOptions
    task_type = ReachObstaclesTask


class ArmReachObstaclesEnv(TaskEnv):
    """`gym.make("armctl/ArmReachObstacles-v0", **options)`; options in `armctl.tasks.ReachObstaclesOptions`."""

    vector_type = ArmReachObstaclesVectorEnv


class BridgeCrossVectorEnv(TaskVectorEnv):
    """`gym.make_vec("armctl/BridgeCross-v0", num_envs=n, **options)`; options in `armctl.tasks.BridgeOptions`."""

    metadata = TaskVectorEnv.metadata | {"render_fps": 10}
    task: BridgeTask
    options_type = BridgeOptions
    task_type = BridgeTask


class BridgeCrossEnv(TaskEnv):
    """`gym.make("armctl/BridgeCross-v0", **options)`; options in `armctl.tasks.BridgeOptions`."""

    metadata = BridgeCrossVectorEnv.metadata
    vector_type = BridgeCrossVectorEnv
