"""Environments in other processes: of another Python, with packages that this one cannot have."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError, ConnectionFailed, EnvironmentFailed
from armctl.remote.connection import TO_START, Connection, OtherEndFailed, host_of, in_words
from armctl.remote.names import SERVERS


class RemoteEnv(gymnasium.Env[Any, Any]):
    """An environment that another Python runs, `python=INTERPRETER:MODULE:ID`, as Gymnasium has environments.

    All of one name are in one process, each with a connection and a thread of its own. `timeout` is the time (s) that
    it may take for a step. Raises `ConfigurationError` if it cannot be made.
    """

    def __init__(self, name: str, timeout: float = 10.0, **options: Any) -> None:
        if name.startswith(SERVERS):
            raise ConfigurationError(f"{name} is a policy server: an environment is python=INTERPRETER:MODULE:ID")
        self._name, self._host = name, host_of(name, "environment")
        try:
            self._connection = Connection(self._host.url, TO_START)
            facts = self._connection.ask({"armctl": "make", "options": options})
        except (ConnectionFailed, OtherEndFailed) as error:
            raise ConfigurationError(f"{name} could not be made: {in_words(error)}") from error
        self._connection.patience = timeout
        self.identity = str(self._connection.metadata.get("identity"))
        """What determines its episodes, as far as the process says."""
        self.observation_space, self.action_space = _space(facts["observation_space"]), _space(facts["action_space"])
        self.metadata = facts["metadata"]
        self.render_mode = options.get("render_mode")
        self.max_episode_steps: int | None = facts["max_episode_steps"]
        if facts["dt"] is not None:
            self.dt = float(facts["dt"])
        if not facts["takes_seed"]:
            raise ConfigurationError(f"{name}: reset takes no seed, so that no episode could be repeated")

    @property
    def patience(self) -> float:
        """Time that an answer may take, s."""
        return self._connection.patience

    @patience.setter
    def patience(self, seconds: float) -> None:
        self._connection.patience = seconds

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> Any:
        """Begin an episode. Raises `EnvironmentFailed`."""
        result = self._answer({"armctl": "reset", "seed": seed})["result"]
        return self._parts(result)

    def step(self, action: Any) -> Any:
        """Make a step. Raises `EnvironmentFailed`."""
        return self._parts(self._answer({"armctl": "step", "action": action})["result"])

    def render(self) -> NDArray[np.uint8]:
        """Return a picture (height, width, 3). Raises `EnvironmentFailed`."""
        return np.asarray(self._answer({"armctl": "render"})["result"])

    def close(self) -> None:
        """End the connection, and with the last one, the process."""
        self._connection.close()

    def _answer(self, message: dict[str, Any]) -> dict[str, Any]:
        try:
            return self._connection.ask(message)
        except (ConnectionFailed, OtherEndFailed) as error:
            raise EnvironmentFailed(in_words(error)) from error

    def _parts(self, result: Any) -> Any:
        """Return what the environment has returned, with the observation as its space has it."""
        if not isinstance(result, list) or not result:
            return result
        return (_in_space(result[0], self.observation_space), *result[1:])


def _in_space(value: Any, space: spaces.Space[Any]) -> Any:
    """Return an observation with tuples, which messages hold as lists."""
    if isinstance(space, spaces.Tuple) and isinstance(value, list):
        return tuple(_in_space(item, part) for item, part in zip(value, space.spaces, strict=False))
    if isinstance(space, spaces.Dict) and isinstance(value, dict):
        return {name: _in_space(item, space[name]) if name in space.spaces else item for name, item in value.items()}
    return np.array(value, space.dtype) if isinstance(space, spaces.Box) and isinstance(value, list) else value


def _space(description: dict[str, Any]) -> spaces.Space[Any]:
    """Return the space that a process describes. Raises `ConfigurationError`."""
    match description:
        case {"Box": {"low": low, "high": high, "dtype": dtype}}:
            return spaces.Box(low, high, dtype=np.dtype(dtype).type)
        case {"Discrete": {"n": n, "start": start}}:
            return spaces.Discrete(n, start=start)
        case {"MultiDiscrete": {"nvec": nvec}}:
            return spaces.MultiDiscrete(nvec)
        case {"MultiBinary": {"n": n}}:
            return spaces.MultiBinary(n.tolist())
        case {"Dict": dict(parts)}:
            return spaces.Dict({name: _space(part) for name, part in parts.items()})
        case {"Tuple": dict(parts)}:
            return spaces.Tuple([_space(part) for part in parts.values()])
    raise ConfigurationError(f"a process described no space that armctl knows: {description}")
