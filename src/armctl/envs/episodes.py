"""Common part of armctl's vector environments: episodes by number, and worlds that are reset one by one."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array, Observations
from armctl.core.errors import ConfigurationError, InvalidAction
from armctl.core.foresight import check_declared
from armctl.disturbances import Disturbance, begin_episodes
from armctl.envs.observations import action_numbers
from armctl.simulation.planning_model import PlanningModel

Infos = dict[str, Any]
LARGEST_SEED = 2**62


class EpisodeVectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """n worlds in which seed and episode number determine an episode.

    `reset(options={"episode": k})` starts at episode k of the seed instead of 0; k is an int, or one int per world.
    `infos` have the same keys after `reset` and `step`, all of numbers: `outcome_id` (n,), an index into `outcomes` or
    -1 while an episode runs, `is_success` (n,) with None where that is unknown, and `reward_terms`, (n,) each.
    """

    task: Any
    """A `Task`, or what stands for one in the environments of others (`ThirdPartyTask`)."""
    outcomes: tuple[str, ...]
    """Possible ends of an episode, by `outcome_id`; the last one is `running`."""
    max_episode_steps: int | None
    autoreset_mode: AutoresetMode
    disturbances: dict[str, Disturbance]
    stated_return_bounds: tuple[float, float] | None = None
    """Least and largest possible return, as stated for a comparison."""
    normalized = False
    """True if actions are from -1 to 1, and not in the task's units."""

    def __init__(self, num_envs: int) -> None:
        self.num_envs = num_envs
        self._seeds = np.zeros(num_envs, dtype=np.int64)
        self._episodes = np.full(num_envs, -1)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._finished = np.ones(num_envs, dtype=bool)
        self._seeded = False
        self.remarks: dict[str, None] = {}
        """Remarks on what these worlds have returned so far, in order."""
        self.on_begin: list[Callable[[NDArray[np.int32]], None]] = []
        """Called with the indices of worlds that have begun a new episode."""
        self.clock: NDArray[np.int64] = np.zeros(num_envs, dtype=np.int64)
        """(n,) a copy of the control steps of each world's current episode, for policies: nothing else reads it."""

    def reset(
        self, *, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Start new episodes in all worlds, or in those of the boolean mask `options["reset_mask"]` (n,).

        With `seed`, world i starts episode 0 of seed + i (or of seed[i]). Without it, each world starts its next one.
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
        self._begin_next(np.flatnonzero(mask))
        return self._observe(), self._infos()

    @abstractmethod
    def step(self, actions: ArrayLike) -> tuple[Observations, Array, NDArray[np.bool_], NDArray[np.bool_], Infos]:
        """Make one control step in every world. If an action is invalid, raises `InvalidAction` and steps nothing."""

    def invalid_actions(self, actions: Any) -> dict[int, InvalidAction]:
        """Return what is wrong with the actions, by world. Raises `InvalidAction` if it is unknown in which worlds."""
        try:
            self._checked(actions)
        except InvalidAction as error:
            if not error.by_world:
                raise
            return {i: InvalidAction(message) for i, message in error.by_world.items()}
        return {}

    def abandon(self, ids: NDArray[np.integer[Any]]) -> None:
        """End the episodes of worlds `ids`: without an autoreset, they stand still until they are reset."""
        self._finished[ids] = True

    def limit_answers(self, seconds: float) -> bool:
        """Limit the time of each answer of worlds in other processes; return whether these are in others."""
        return False

    @abstractmethod
    def render(self) -> Any:
        """Return images (height, width, 3) of all worlds, as a tuple."""

    @property
    def foresight(self) -> tuple[str, ...]:
        """Foresight that policies can have here: keys of `FORESIGHT`."""
        has_simulator = self._nominal_model() is not None
        return (
            *self.task.foresight,
            *(("disturbance",) if self.disturbances else ()),
            *(("simulator",) if has_simulator else ()),
        )

    def preview(self, name: str, world: int = 0) -> Any:
        """Return what a policy with this foresight knows of a world's current episode; None if nothing is foreseen.

        For a `disturbance`, that is the level of each by name, for a `simulator` the `model`, and else what
        `Task.preview` tells. Raises `ConfigurationError` while a policy acts that has not declared it.
        """
        if self.task.granted is not None:
            check_declared(name, "state", self.task.granted)
        if name == "disturbance":
            return {name: float(disturbance.levels[world]) for name, disturbance in self.disturbances.items()}
        if name == "simulator":
            return self._planning_model() if "simulator" in self.foresight else None
        return self.task.preview(name, world) if name in self.task.foresight else None

    def model(self) -> PlanningModel:
        """Return a new copy of the nominal model, for a policy that plans by simulation.

        Raises `ConfigurationError` if there is none, and while a policy acts that does not foresee the `simulator`.
        """
        if (model := self.preview("simulator")) is None:
            raise ConfigurationError(f"{type(self.task).__name__} has no model of MuJoCo's to plan in")
        assert isinstance(model, PlanningModel)
        return model

    @abstractmethod
    def _nominal_model(self) -> mujoco.MjModel | None:
        """Return MuJoCo's model without disturbances, which act on others; None if there is none."""

    @abstractmethod
    def _planning_model(self) -> PlanningModel:
        """Return a new copy of the nominal model, which there is, with rollouts."""

    @property
    def control_period(self) -> float | None:
        """Seconds between two control steps; None if the environment does not say."""
        return self.task.control_period  # type: ignore[no-any-return]

    @property
    def return_bounds(self) -> tuple[float, float] | None:
        """Least and largest possible return of an episode: those stated, or those of the task; None if unknown."""
        if self.stated_return_bounds is not None:
            return self.stated_return_bounds
        return self.task.return_bounds(self.max_episode_steps)  # type: ignore[no-any-return]

    @property
    def idle_action(self) -> Array:
        """The action that leaves the robot where it starts."""
        return np.asarray(self.task.idle_action)

    @property
    def seeds(self) -> NDArray[np.int64]:
        """Seed of each world's current episode, (n,)."""
        return self._seeds.copy()

    @property
    def episodes(self) -> NDArray[np.int64]:
        """Number of each world's current episode under its seed, (n,)."""
        return self._episodes.copy()

    def perceived(self) -> Any:
        """Return what policies that see the state read it from: the task, or what disturbances let them know of it.

        A disturbance acts on the numbers of `task.state_observation()`, and `task.perceived(numbers)` makes of them
        what is read in place of the task. Rewards and outcomes stay true.
        """
        acting = [disturbance for disturbance in self.disturbances.values() if "state" in disturbance.channels]
        if not acting:
            return self.task
        numbers = self.task.state_observation()
        for disturbance in acting:
            numbers = disturbance.perceive(numbers)
        return self.task.perceived(numbers)

    @abstractmethod
    def _infos(self) -> Infos:
        """Return what `reset` tells of the new episodes."""

    @abstractmethod
    def _begin(self, ids: NDArray[np.int32]) -> None:
        """Start the new episodes of worlds `ids`, which `_episodes` numbers."""

    @abstractmethod
    def _observe(self) -> Observations:
        """Return observations of all worlds."""

    def _begin_next(self, ids: NDArray[np.integer[Any]]) -> None:
        self._episodes[ids] += 1
        self._steps[ids] = 0
        self._finished[ids] = False
        worlds = ids.astype(np.int32)
        begin_episodes(self.disturbances, worlds, self._seeds, self._episodes)
        self._begin(worlds)
        for callback in self.on_begin:
            callback(worlds)
        self.clock[:] = self._steps

    def _disturbed_commands(self, commands: Any) -> Any:
        for disturbance in self.disturbances.values():
            commands = disturbance.command(commands)
        return commands

    def _disturbed_observations(self, observations: Observations, ids: Any = slice(None)) -> Observations:
        for disturbance in self.disturbances.values():
            observations = disturbance.observe(observations, ids)
        return observations

    def _checked(self, actions: Any) -> Any:
        """Return actions that `step` takes. Raises `InvalidAction`."""
        return self._checked_numbers(actions)

    def _checked_numbers(self, actions: ArrayLike) -> Array:
        """Return actions as numbers of the right shape. Raises `InvalidAction`."""
        checked = action_numbers(actions)
        expected = (self.num_envs, *(self.single_action_space.shape or ()))
        if checked.shape != expected:
            raise InvalidAction(f"actions have shape {checked.shape}; expected {expected}")
        return self._finite(checked)

    def _finite(self, checked: Array) -> Array:
        """Return actions that are finite. Raises `InvalidAction` if one is not."""
        if np.count_nonzero(np.isfinite(checked)) < checked.size:
            worlds = np.flatnonzero(~np.isfinite(checked).reshape(self.num_envs, -1).all(axis=1))
            raise InvalidAction(
                f"action {checked[worlds[0]]} of world {worlds[0]} is not finite; no world was stepped",
                {int(i): f"its action {checked[i]} is not finite" for i in worlds},
            )
        return checked

    def _check_seeded(self) -> None:
        if not self._seeded:
            raise gymnasium.error.ResetNeeded("call reset() before the first step()")

    def _whole_numbers(self, name: str, seeds: Any) -> NDArray[np.int64]:
        numbers = np.array([_folded(seed) for seed in seeds] if isinstance(seeds, list) else _folded(seeds))
        usable = numbers.shape in ((), (self.num_envs,)) and numbers.dtype.kind in "iu"
        if not usable or (numbers < 0).any() or (numbers >= LARGEST_SEED).any():
            raise ConfigurationError(f"{name} is a whole number from 0 on, or {self.num_envs} of them, not {seeds!r}")
        return np.broadcast_to(numbers, self.num_envs).astype(np.int64)


def _folded(number: Any) -> Any:
    """Return a seed, mixed into the upper half of the seeds if it is too large, as some libraries draw them."""
    if not isinstance(number, (int, np.integer)) or number < LARGEST_SEED:
        return number
    half = LARGEST_SEED // 2
    return half + int(np.random.SeedSequence(int(number)).generate_state(1, np.uint64)[0]) % half
