"""Plain Python as policies: functions, classes and models of one world's observation, without a batch axis."""

import copy
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from armctl.core.arrays import Observations, object_array
from armctl.core.errors import ConfigurationError, InvalidAction, defined_at
from armctl.envs import EpisodeVectorEnv, Interface, PolicyStreams, Sees, ThirdPartyVectorEnv
from armctl.envs.single import OneWorld
from armctl.policies.interfaces import framed, frames_of, stacking
from armctl.policies.policy import Actions, PerWorld, Policy
from armctl.policies.privilege import as_declared, granting, knowledge_for

ENV_PARAMETERS = {"env", "envs", "environment", "worlds"}
"""Names of parameters that are given what a policy may know of its environment."""

Worlds = EpisodeVectorEnv | Interface
"""An environment, for a policy that sees the state; for all others, what they are told about it."""


def adapted(source: Any, worlds: Worlds, name: str, streams: PolicyStreams) -> Policy:
    """Return a policy from any object that `make_policy` takes, made of what it declares to see, and `streams`.

    Raises `ConfigurationError`.
    """
    knowledge = knowledge_for(source, worlds, name, streams)
    frames = frames_of(source, worlds, name)
    if frames > 1:
        knowledge = stacking(knowledge, frames)
    with granting(source, worlds):
        unlabelled = _adapted(source, knowledge, name)
    policy: Policy = framed(as_declared(unlabelled, name, source), frames, worlds.num_envs)
    return policy


def _adapted(source: Any, worlds: Worlds, name: str) -> Policy:
    if isinstance(source, type):
        if _acts_in_batches(source):
            return source(worlds)  # type: ignore[no-any-return]
        if not callable(getattr(source, "act", None)):
            raise ConfigurationError(f"{name} is a class without act(observation){defined_at(source)}")
        return PlainPolicy([_instance(source, worlds, i) for i in range(worlds.num_envs)], worlds, source)
    if isinstance(source, Policy):
        return source
    if callable(getattr(source, "predict", None)):
        return ModelPolicy(source, worlds, name)
    if callable(getattr(source, "act", None)):
        return PlainPolicy([source, *(copy.deepcopy(source) for _ in range(worlds.num_envs - 1))], worlds, source)
    if not callable(source):
        raise ConfigurationError(
            f"{name} is of type {type(source).__name__}, which cannot be called: it is not a policy"
        )
    if _makes_policies(source):
        return _from_factory(source, worlds, name)
    return PlainPolicy([_Function(source)] * worlds.num_envs, worlds, source)


class PlainPolicy(PerWorld):
    """A policy that consists of one plain controller for each world; it checks their actions.

    A controller has `act(observation)`. `reset()`, `plans()`, `failures`, `sees` and `training_steps` are optional.
    """

    def __init__(self, controllers: list[Any], worlds: Worlds, source: Any) -> None:
        super().__init__(controllers, getattr(controllers[0], "sees", "observation"))
        if (reads := getattr(controllers[0], "reads", None)) is not None:
            self.reads = reads
        self.training_steps = int(getattr(controllers[0], "training_steps", 0))
        self._space, self._source = worlds.single_action_space, source

    def _reset_one(self, world: int) -> None:
        """Let a controller with a memory forget the last episode."""
        getattr(self.controllers[world], "reset", lambda: None)()

    def _act_one(self, world: int, observations: Observations) -> Any:
        """Return a controller's action. Raises `InvalidAction`."""
        action = super()._act_one(world, observations)
        return self._numbers(action) if isinstance(self._space, spaces.Box) else action

    def _batch(self, actions: list[Any]) -> Actions:
        return np.array(actions) if isinstance(self._space, spaces.Box) else object_array(actions)

    def _numbers(self, action: Any) -> NDArray[np.float64]:
        try:
            numbers = np.array(action, dtype=float)
        except (TypeError, ValueError):
            numbers = None
        if action is not None and numbers is not None and numbers.shape == self._space.shape:
            return numbers
        returned = repr(action) if action is None or numbers is None else f"an action of shape {numbers.shape}"
        raise InvalidAction(
            f"it returned {returned}; expected are numbers of shape {self._space.shape}{defined_at(self._source)}"
        )


class ModelPolicy:
    """A model with the `predict` of Stable-Baselines3's, recurrent ones included."""

    sees: Sees = "observation"
    reads = ("observation",)

    def __init__(self, model: Any, worlds: Worlds, name: str) -> None:
        space = worlds.single_action_space
        if (trained := getattr(model, "action_space", space)) != space:
            raise ConfigurationError(f"the actions of {name} are {trained}; here they are {space}")
        self.training_steps = int(getattr(model, "num_timesteps", 0))
        self._model = model
        self._normalizer = getattr(model, "get_vec_normalize_env", lambda: None)()
        self._state: Any = None
        self._starts = np.ones(worlds.num_envs, dtype=bool)

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`: a recurrent model forgets the last one."""
        self._starts[ids] = True

    def act(self, observations: Observations) -> Actions:
        """Return the model's deterministic actions."""
        if self._normalizer is not None:
            observations = self._normalizer.normalize_obs(observations)
        actions, self._state = self._model.predict(
            observations, state=self._state, episode_start=self._starts, deterministic=True
        )
        self._starts[:] = False
        return np.asarray(actions)


class _Function:
    """A function of the observation as a controller without memory."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self.act = function
        self.sees = getattr(function, "sees", "observation")
        self.reads = getattr(function, "reads", ("observation",))  # it is given nothing else


def _from_factory(factory: Callable[..., Any], worlds: Worlds, name: str) -> Policy:
    """Return what a factory makes: a policy for all worlds, or one controller per world, made with what is its own."""
    takes_env = bool(inspect.signature(factory).parameters)
    policy = factory(worlds) if takes_env else factory()
    if isinstance(policy, Policy):
        return policy
    if not callable(getattr(policy, "act", None)):
        raise ConfigurationError(
            f"{name} made something of type {type(policy).__name__}, which is not a policy: it needs act(observation)"
            f"{defined_at(factory)}"
        )
    if takes_env:
        controllers = [factory(_one_world(worlds, i)) for i in range(worlds.num_envs)]
    else:
        controllers = [policy, *(factory() for _ in range(worlds.num_envs - 1))]
    return PlainPolicy(controllers, worlds, factory)


def _acts_in_batches(source: Any) -> bool:
    return all(hasattr(source, name) for name in ("sees", "training_steps", "reset", "act"))


def _makes_policies(function: Callable[..., Any]) -> bool:
    """Return True if a function is given an environment, or nothing, rather than an observation."""
    try:
        parameters = list(inspect.signature(function).parameters.values())
    except (TypeError, ValueError):  # built-in functions have none
        return False
    return not parameters or parameters[0].name in ENV_PARAMETERS


def _instance(cls: type[Any], worlds: Worlds, i: int) -> Any:
    """Return an instance of a controller's class for world i."""
    parameters = inspect.signature(cls).parameters.values()
    wants_env = next((parameter.name for parameter in parameters if parameter.name in ENV_PARAMETERS), None)
    if wants_env is None:
        return cls()
    return cls(**{wants_env: _one_world(worlds, i)})


def _one_world(worlds: Worlds, i: int) -> Any:
    """Return what a controller of world i is given of its environment."""
    if isinstance(worlds, Interface):
        return worlds.in_world(i)
    return worlds.worlds[i] if isinstance(worlds, ThirdPartyVectorEnv) else OneWorld(worlds, i)
