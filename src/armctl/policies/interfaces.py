"""Interfaces that policies are made for: how they see and command the robot, and how many observations at a time."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from armctl.core.arrays import Array, Observations, map_arrays
from armctl.core.declarations import Declaration, declaration_of_code
from armctl.core.errors import ConfigurationError, unknown_name
from armctl.envs import EpisodeVectorEnv, Interface, interface_values
from armctl.policies.declare import FRAMES, checked_interface, unwrapped
from armctl.policies.names import policy_names, without_filter
from armctl.policies.policy import Actions, Code, PlaysApart, Policy
from armctl.remote.names import is_remote

ARRAYS = (spaces.Box, spaces.Discrete, spaces.MultiBinary, spaces.MultiDiscrete)


def declared_interface(policy: Any) -> dict[str, Any]:
    """Return the options of the interface that a policy is made for, and its `frames`, by `armctl.interface`.

    `policy` is of any form that `make_policy` takes. Code that is named is read, and not imported: before a policy is
    made, nothing of it may run. Of a server, nothing is known here. Raises `ConfigurationError`.
    """
    if not isinstance(policy, (str, Path)):
        return _interface_in(policy)
    name = without_filter(str(policy))
    if ":" not in name or name.partition(":")[0] in policy_names() or is_remote(name):
        return {}
    code = declaration_of_code(name) or Declaration()
    _, options = code.decorators.get("interface", ([], code.values.get("interface", {})))
    return checked_interface(options)


def _interface_in(source: Any) -> dict[str, Any]:
    options = getattr(unwrapped(source), "interface", {})
    return {} if callable(options) or isinstance(options, property) else checked_interface(options)


def frames_of(source: Any, env: EpisodeVectorEnv | Interface, name: str) -> int:
    """Return the number of observations in a stack for the policy called `name`, which comes from this source.

    Raises `ConfigurationError` unless the environment has the interface that the policy is made for.
    """
    options, values = _interface_in(source), interface_values(env)
    for option, value in options.items():
        if option != FRAMES:
            check_option(option, values, name)
            if not _is_same(values[option], value):
                raise ConfigurationError(
                    f"{name} is made for {option}={value!r}, and {option} is {values[option]!r} here. armctl chooses "
                    "it by the literals in @armctl.interface(...) above the policy's function or class"
                )
    return int(options.get(FRAMES, 1))


def check_option(option: str, allowed: Any, name: str) -> None:
    """Raise `ConfigurationError` for an option of a policy's interface that the environment does not have."""
    if option not in allowed:
        raise unknown_name(f"option of an interface here, which {name} declares,", option, [*allowed, FRAMES])


def _is_same(value: Any, declared: Any) -> bool:
    if isinstance(value, Sequence) and isinstance(declared, Sequence):
        return list(value) == list(declared)
    return bool(value == declared)


def stacking(env: EpisodeVectorEnv | Interface, frames: int) -> EpisodeVectorEnv | Interface:
    """Return what a policy knows of an environment, with the spaces of stacks of `frames` observations.

    Raises `ConfigurationError` for observations that are no arrays.
    """
    space = env.single_observation_space
    if not all(isinstance(part, ARRAYS) for part in _parts(space)):
        raise ConfigurationError(f"{FRAMES} are stacked of arrays, not of {space}")
    return replace(env, single_observation_space=batch_space(space, frames)) if isinstance(env, Interface) else env


def _parts(space: spaces.Space[Any]) -> list[spaces.Space[Any]]:
    return [part for inner in space.values() for part in _parts(inner)] if isinstance(space, spaces.Dict) else [space]


class Framed:
    """A policy that gets the last `frames` observations of each of n worlds; in all else, it is the policy itself."""

    def __init__(self, policy: Policy, frames: int, n: int) -> None:
        vars(self).update(_policy=policy, _frames=frames, _begins=np.ones(n, dtype=bool), _stack=None)

    def __getattr__(self, name: str) -> Any:
        return getattr(vars(self)["_policy"], name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._policy, name, value)

    @property
    def sees(self) -> Any:
        """Privilege of the policy."""
        return self._policy.sees

    @property
    def training_steps(self) -> int:
        """Environment steps of its training."""
        return int(self._policy.training_steps)

    def plans(self, world: int) -> Mapping[str, Array]:
        """Return the policy's plans; none of one that does not tell them."""
        return dict(getattr(self._policy, "plans", lambda world: {})(world))

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`. Raises what the policy raises."""
        self._begins[ids] = True
        self._policy.reset(ids)

    def act(self, observations: Observations) -> Actions:
        """Return actions for the present observations (n, ...), as the last of stacks (n, frames, ...)."""
        stack = map_arrays(self._repeated, observations)
        if self._stack is not None:
            stack = map_arrays(self._moved, stack, self._stack)
        vars(self)["_stack"] = stack
        self._begins[:] = False
        actions: Actions = self._policy.act(map_arrays(np.copy, stack))
        return actions

    def _repeated(self, values: NDArray[Any]) -> NDArray[Any]:
        return np.repeat(np.asarray(values)[:, None], self._frames, axis=1)

    def _moved(self, new: NDArray[Any], last: NDArray[Any]) -> NDArray[Any]:
        """Return stacks in which those of episodes that go on are the last ones, with the present frame added."""
        goes_on = ~self._begins
        new[goes_on, :-1] = last[goes_on, 1:]
        return new


class FramedApart(Framed):
    """The same of a policy that plays in another process: `PlaysApart`."""

    @property
    def code(self) -> Code | None:
        """Identity of its code."""
        return self._policy.code  # type: ignore[no-any-return]

    @property
    def patience(self) -> float:
        """Time that the process may take for an answer, s."""
        return float(self._policy.patience)

    @property
    def seconds(self) -> float:
        """Duration of the last call, as measured in that process."""
        return float(self._policy.seconds)

    def close(self) -> None:
        """End the connection."""
        self._policy.close()


def framed(policy: Any, frames: int, n: int) -> Any:
    """Return a policy that gets the last `frames` observations of each of n worlds."""
    if frames == 1:
        return policy
    return (FramedApart if isinstance(policy, PlaysApart) else Framed)(policy, frames, n)
