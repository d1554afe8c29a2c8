"""Policies, which map observations to actions, classical or learned; and how they are found.

A package offers a policy under the entry-point group `armctl.policies`: a function from an environment to a `Policy`.
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.agents import load_agent
from armctl.envs import TaskEnv, TaskVectorEnv, one_of
from armctl.errors import ArmctlError, ConfigurationError, unknown_name
from armctl.registration import import_attribute, installed
from armctl.tasks import Observations

Actions = NDArray[np.floating[Any]]
GROUP = "armctl.policies"


@runtime_checkable
class Policy(Protocol):
    """Acts in n worlds at once.

    Two attributes are optional, and go into the results: `failures` (n,), the number of times that its solver has
    failed in each world, and `training_minutes`.
    """

    sees: Literal["observation", "state"]
    """What it is allowed to see: only the environment's observation, or privileged state as well."""
    training_steps: int
    """Environment steps of its training; 0 for a policy that was not trained."""

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Worlds `ids` start a new episode."""

    def act(self, observations: Observations) -> Actions:
        """Actions (n, ...) for the observations (n, ...) of all worlds."""


@runtime_checkable
class Plans(Protocol):
    """A policy that can show its plans."""

    def plans(self, world: int) -> Mapping[str, NDArray[np.float64]]:
        """Polylines by name, (m, 3) m each: the `path` it follows, the `horizon` it predicts; none before it plans."""


class Controller(Protocol):
    """Acts in one world."""

    def reset(self) -> None:
        """A new episode starts."""

    def act(self, observation: Any) -> Actions:
        """The action for one world's observation."""


PolicyFactory = Callable[[TaskVectorEnv], Policy]


class PerWorld:
    """A policy that consists of one controller for each world."""

    training_steps = 0

    def __init__(
        self, controllers: Sequence[Controller], sees: Literal["observation", "state"] = "observation"
    ) -> None:
        self.controllers = controllers
        self.sees = sees

    @property
    def failures(self) -> NDArray[np.int64]:
        """(n,) number of solver failures of each controller; 0 for controllers that do not count them."""
        return np.array([getattr(controller, "failures", 0) for controller in self.controllers])

    def plans(self, world: int) -> Mapping[str, NDArray[np.float64]]:
        """The plans of the world's controller; none if it does not have the method `plans`."""
        return dict(getattr(self.controllers[world], "plans", dict)())

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Worlds `ids` start a new episode."""
        for i in ids:
            self.controllers[i].reset()

    def act(self, observations: Observations) -> Actions:
        """Each controller's action for its own observation."""
        return np.array([controller.act(one_of(observations, i)) for i, controller in enumerate(self.controllers)])


def policy_names() -> list[str]:
    """Names of all installed policies."""
    return sorted(installed(GROUP).names)


def describe_policy(name: str) -> str:
    """First line of the docstring of an installed policy's factory."""
    return (inspect.getdoc(installed(GROUP)[name].load()) or "").partition("\n")[0]


def policy_name(policy: Any) -> str:
    """A policy's name in results."""
    return str(policy) if isinstance(policy, (str, Path)) else getattr(policy, "__name__", type(policy).__name__)


def make_policy(policy: str | Path | PolicyFactory | Policy, env: gymnasium.Env[Any, Any] | TaskVectorEnv) -> Policy:
    """Make a policy for the worlds of `env`.

    `policy` is an installed policy's name, the path of a learned agent's `.json` card or `.onnx` graph,
    `module:function` or a function from an environment to a policy, or a policy itself.

    Raises `ConfigurationError` for an unknown name, and `AgentFileError` for a file that cannot be run here.
    """
    worlds = env.unwrapped
    if isinstance(worlds, TaskEnv):
        worlds = worlds.worlds
    if not isinstance(worlds, TaskVectorEnv):
        raise ConfigurationError(f"policies act in armctl's environments; {env} is not one of them")
    if isinstance(policy, Policy) and not isinstance(policy, type):
        return policy
    try:
        made = _factory(policy)(worlds)
    except ArmctlError:
        raise
    except Exception as error:
        raise ConfigurationError(f"{policy_name(policy)} could not be made: {type(error).__name__}: {error}") from error
    if not isinstance(made, Policy):
        raise ConfigurationError(
            f"{policy_name(policy)} made a {type(made).__name__}, which is not a policy: "
            "it needs sees, training_steps, reset and act"
        )
    return made


def _factory(policy: Any) -> PolicyFactory:
    if callable(policy):
        return policy  # type: ignore[no-any-return]
    name = str(policy)
    if Path(name).suffix in (".onnx", ".json"):
        return lambda worlds: load_agent(Path(name), worlds)
    if name in policy_names():
        return installed(GROUP)[name].load()  # type: ignore[no-any-return]
    if ":" not in name:
        raise unknown_name("policy", name, [*policy_names(), "path/to/agent.json", "module:function"])
    return import_attribute(name, "policy")  # type: ignore[no-any-return]
