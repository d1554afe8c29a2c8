"""Knowledge of a policy about its environment: as much as it declares to see, and no more.

Everything in an `Interface` is a copy. Nothing in it leads to the simulation: armctl writes into it when an episode
begins, and never reads it.
"""

import copy
import dataclasses
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError, nearest
from armctl.core.foresight import check_declared, how_to_declare
from armctl.envs.policy_seed import PolicyStreams
from armctl.envs.sees import SEES, Sees

if TYPE_CHECKING:
    from armctl.envs.episodes import EpisodeVectorEnv
    from armctl.simulation.planning_model import PlanningModel


class CurrentEpisode:
    """Knowledge of a policy about one world's current episode. armctl changes it when the next one begins."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.map: Any = None
        self.previews: dict[str, Any] = {}


@dataclass(frozen=True, kw_only=True, eq=False)
class Interface:
    """Knowledge of every policy about n worlds before it acts."""

    sees: ClassVar[Sees] = "observation"
    env_id: str
    num_envs: int
    single_observation_space: gymnasium.Space[Any]
    """Observation space of one world."""
    single_action_space: gymnasium.Space[Any]
    """Action space of one world."""
    control_period: float | None
    """Seconds between two control steps; None if the environment does not say."""
    max_episode_steps: int | None
    interface: Mapping[str, str]
    """Facts that a learned policy depends on, such as robot and control, by `Task.interface`."""
    idle_action: NDArray[Any] | None
    """The action that leaves the robot where it starts; None if actions are not boxes."""
    normalized: bool = False
    """True if actions are from -1 to 1, and not in the task's units."""
    of_one_world: bool = False
    """True if the policy acts in one world, without a batch axis."""
    foresight: tuple[str, ...] = ()
    """Foresight that the policy declares: keys of `FORESIGHT`."""
    _episodes: Sequence[CurrentEpisode] = ()
    _steps: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, dtype=np.int64))
    _model: "PlanningModel | None" = None
    _values: Mapping[str, Any] = field(default_factory=dict)

    @functools.cached_property
    def observation_space(self) -> gymnasium.Space[Any]:
        """Observation space of all worlds at once, or of the one world in which the policy acts."""
        return self._space(self.single_observation_space)

    @functools.cached_property
    def action_space(self) -> gymnasium.Space[Any]:
        """Action space of all worlds at once, or of the one world in which the policy acts."""
        return self._space(self.single_action_space)

    def rng(self, world: int = 0) -> np.random.Generator:
        """Return a generator for random choices in a world. armctl seeds it for each episode, by a secret of the run.

        The numbers are the same however many worlds and workers play, and tell neither the episode's seed nor its
        number (see `armctl.envs.policy_seed`).
        """
        return self._episodes[world].rng

    def control_step(self, world: int = 0) -> int:
        """Return how many control steps a world's current episode has taken.

        In real time, several pass between two decisions if the first one takes longer than a control period.
        """
        return int(self._steps[world])

    def preview(self, name: str, world: int = 0) -> Any:
        """Return what a policy with this foresight knows of a world's current episode, by `EpisodeVectorEnv.preview`.

        It is None in an environment that does not tell it. Raises `ConfigurationError` if it was not declared.
        """
        check_declared(name, self.sees, self.foresight)
        return self._model and self._model.copy() if name == "simulator" else self._episodes[world].previews.get(name)

    def model(self) -> "PlanningModel":
        """Return a new copy of the nominal model, for a policy that foresees the `simulator`.

        Raises `ConfigurationError` if that was not declared, or if there is none.
        """
        model: PlanningModel | None = self.preview("simulator")
        if model is None:
            raise ConfigurationError(f"{self.env_id} has no model of MuJoCo's to plan in")
        return model

    def in_world(self, world: int) -> "Interface":
        """Return the interface of a policy that acts in one of the worlds."""
        episodes, steps = (self._episodes[world],), self._steps[world : world + 1]
        return dataclasses.replace(self, num_envs=1, of_one_world=True, _episodes=episodes, _steps=steps)

    def limited_to(self, sees: str, foresight: tuple[str, ...], name: str) -> "Interface":
        """Return what this policy may tell another one, called `name`, which declares what it `sees` and foresees.

        Raises `ConfigurationError` if that is more than this one knows itself.
        """
        if list(SEES).index(sees) > list(SEES).index(self.sees):
            raise ConfigurationError(
                f"{name} sees the {SEES[sees]}, and a policy that is made of it has to declare that too: "
                f"{how_to_declare(sees)}"
            )
        for more in foresight:
            check_declared(more, self.sees, self.foresight)
        kind = INTERFACES[sees]
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(kind)}
        return kind(**fields | {"foresight": foresight})

    def __getattr__(self, name: str) -> Any:
        """Raise an AttributeError that says which declaration gives a missing attribute."""
        if name.startswith("_"):
            raise AttributeError(name)
        names = [attribute for attribute in dir(type(self)) if not attribute.startswith("_")]
        names += [field.name for field in dataclasses.fields(self) if not field.name.startswith("_")]
        needed = next((sees for sees, kind in INTERFACES.items() if name in _names(kind)), "state")
        raise AttributeError(
            f"env.{name} is not for a policy that sees the {SEES[self.sees]}.{nearest(name, names)} If it needs it, it "
            f"has to say so: {how_to_declare(needed)}"
        )

    def _space(self, single: gymnasium.Space[Any]) -> gymnasium.Space[Any]:
        return single if self.of_one_world else batch_space(single, self.num_envs)


@dataclass(frozen=True, kw_only=True, eq=False)
class ModelInterface(Interface):
    """Interface of policies that use a model of the robot."""

    sees: ClassVar[Sees] = "model"
    robot: Any
    """Description of the robot (`armctl.robot_description.ArmDescription`); None if the task has none."""
    options: Any
    """The task's options; None if it has none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MapInterface(ModelInterface):
    """Interface of policies that see the map as well: what stands still during an episode."""

    sees: ClassVar[Sees] = "map"

    def map(self, world: int = 0) -> Any:
        """Return the static surroundings in a world's current episode, by `Task.static_map`."""
        return self._episodes[world].map


INTERFACES: Mapping[str, type[Interface]] = {"observation": Interface, "model": ModelInterface, "map": MapInterface}
"""Interfaces by privilege. The state has none: such a policy gets the environment itself."""


def interface_of(
    worlds: "EpisodeVectorEnv", sees: str, streams: PolicyStreams, foresight: tuple[str, ...] = ()
) -> Interface:
    """Return what a policy with this privilege and foresight is told about these worlds.

    `sees` is a key of `INTERFACES`. The policy's random numbers come from `streams`.
    """
    kind, task = INTERFACES[sees], worlds.task
    episodes = [CurrentEpisode(streams.generator(i)) for i in range(worlds.num_envs)]

    def begin(ids: NDArray[np.integer[Any]]) -> None:
        seeds, numbers = worlds.seeds, worlds.episodes
        for i in ids:
            # the object stays the same: a policy may keep it
            episodes[i].rng.bit_generator.state = streams.generator(int(seeds[i]), int(numbers[i])).bit_generator.state
            if issubclass(kind, MapInterface):
                episodes[i].map = task.static_map(int(i))
            episodes[i].previews = {name: worlds.preview(name, int(i)) for name in foresight if name != "simulator"}

    begin(np.flatnonzero(worlds.episodes >= 0))
    worlds.on_begin.append(begin)
    more: dict[str, Any] = {}
    if issubclass(kind, ModelInterface):
        more = {"robot": copy.deepcopy(task.robot), "options": copy.deepcopy(getattr(task, "options", None))}
    boxed = isinstance(worlds.single_action_space, gymnasium.spaces.Box)
    return kind(
        env_id=worlds.spec.id if worlds.spec else type(worlds).__name__,
        num_envs=worlds.num_envs,
        single_observation_space=copy.deepcopy(worlds.single_observation_space),
        single_action_space=copy.deepcopy(worlds.single_action_space),
        control_period=task.control_period,
        max_episode_steps=worlds.max_episode_steps,
        interface=MappingProxyType(dict(task.interface)),
        idle_action=np.array(worlds.idle_action) if boxed else None,
        normalized=worlds.normalized,
        foresight=foresight,
        _episodes=episodes,
        _steps=worlds.clock,
        _model=worlds.preview("simulator") if "simulator" in foresight else None,
        _values=interface_values(worlds),
        **more,
    )


def interface_values(env: "EpisodeVectorEnv | Interface") -> dict[str, Any]:
    """Return the values of the options that say how policies see and command the robot."""
    if isinstance(env, Interface):
        return dict(env._values)
    options = getattr(env.task, "options", None)
    values = {name: getattr(options, name) for name in sorted(env.task.interface_options) if hasattr(options, name)}
    units = "normalized" if env.normalized else "physical"
    return values | ({"actions": units} if "actions" in env.task.interface_options else {})


def _names(kind: type[Interface]) -> set[str]:
    return {*dir(kind), *(field.name for field in dataclasses.fields(kind))}
