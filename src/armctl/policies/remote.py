"""Policies in other processes: policy servers, `ws://HOST:PORT`, and code for another Python.

A server of armctl's (`armctl serve`) acts in all worlds at once, and its episodes are those of the policy played here.
Any other server is one of openpi's protocol: it gets a map with one world's observation, and answers with a chunk of
`actions` (horizon, ...), which are taken one after the other until the next is asked for. What follows a question mark,
`ws://HOST:PORT?observation=observation/state&prompt=reach`, names the parts of an observation as the server does, and
adds texts to it.
"""

import functools
from collections import deque
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Observations
from armctl.core.errors import ConfigurationError, ConnectionFailed, InvalidAction
from armctl.core.registration import bare_id, remember_named
from armctl.envs import Interface, one_of
from armctl.policies.declare import check_sees, checked_interface
from armctl.policies.policy import Actions, Code, ControllersFailed
from armctl.remote.connection import Connection, Host, OtherEndFailed, error_in, host_of, in_words
from armctl.remote.messages import VERSION
from armctl.remote.names import SERVERS


def remote_policy(name: str) -> Callable[[Interface], "RemotePolicy"]:
    """Return a function that makes the policy, declared to see what its server says that it sees.

    Raises `ConfigurationError` if nothing answers.
    """
    metadata = _connected(name)[0].metadata
    make = functools.partial(RemotePolicy, name)
    make.sees = str(metadata.get("sees", "observation"))  # type: ignore[attr-defined]
    check_sees(make.sees)  # type: ignore[attr-defined]
    options, is_complete = remote_interface(name)
    make.interface = {} if is_complete else options  # type: ignore[attr-defined]
    remember_named(name)
    return make


def remote_interface(name: str) -> tuple[dict[str, Any], bool]:
    """Return the interface that a server's policy is made for, and whether all else is the environment's default.

    That is so for a server of armctl's, which says which environment it plays.
    """
    metadata = _connected(name)[0].metadata
    return checked_interface(metadata.get("interface", {})), "env" in metadata


def _connected(name: str) -> tuple[Connection, Host | None]:
    """Return a connection to the server, and its process if it is one of another Python."""
    host = None if name.startswith(SERVERS) else host_of(name, "policy")
    try:
        connection = Connection(name.partition("?")[0] if host is None else host.url)
    except (ConnectionFailed, OtherEndFailed) as error:
        raise ConfigurationError(f"{name} could not be made: {in_words(error)}") from error
    version = connection.metadata.get("armctl", VERSION)
    if version != VERSION:
        raise ConfigurationError(f"{name} speaks version {version!r} of armctl's protocol, not {VERSION}")
    return connection, host


class RemotePolicy:
    """A policy that plays in another process, from observations."""

    foresight = ()

    def __init__(self, name: str, env: Interface) -> None:
        self.sees: Any = env.sees
        self._name, self._interface = name, env
        self._connection, self._host = _connected(name)
        metadata = self._connection.metadata
        if "env" in metadata and bare_id(str(metadata["env"])) != bare_id(env.env_id):
            raise ConfigurationError(f"{name} plays {metadata['env']}, not {env.env_id}")
        self.training_steps = int(metadata.get("training_steps", 0))
        if "family" in metadata:
            self.family = str(metadata["family"])
        self.kind = metadata.get("kind")
        self.code: Code | None = Code(str(metadata.get("identity", sorted(map(str, metadata.items())))))
        """What determines its episodes, as far as the server says."""
        self.failures: NDArray[np.int64] = np.zeros(env.num_envs, dtype=np.int64)
        self.seconds = 0.0
        """Duration of the last call without the transport of messages, if the server says."""
        self._transports: deque[float] = deque(maxlen=10_000)
        self._in_batches = "armctl" in metadata
        self._names = dict(parse_qsl(name.partition("?")[2]))
        self._chunks: list[deque[Any]] = [deque() for _ in range(env.num_envs)]

    @property
    def transport_ms(self) -> float | None:
        """Time that messages take beside a call of all worlds, median; None before the first, or if nobody says."""
        return 1e3 * float(np.median(self._transports)) if self._transports else None

    @property
    def patience(self) -> float:
        """Time that the server may take for an answer, s."""
        return self._connection.patience

    @patience.setter
    def patience(self, seconds: float) -> None:
        self._connection.patience = seconds

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`. Raises `ConnectionFailed`, and what the policy raises."""
        for i in ids.tolist():
            self._chunks[i].clear()
        self.seconds = 0.0
        if self._in_batches:
            states = [_as_texts(self._interface.rng(i).bit_generator.state) for i in ids.tolist()]
            self._connection.ask(
                {"armctl": "begin", "worlds": self._interface.num_envs, "ids": np.asarray(ids), "rng": states}
            )

    def act(self, observations: Observations) -> Actions:
        """Return actions (n, ...). Raises `ConnectionFailed`, `ControllersFailed`, and what the policy raises."""
        self.seconds = 0.0
        if not self._in_batches:
            return np.array([self._act_one(i, observations) for i in range(self._interface.num_envs)])
        answer = self._answer(
            {"armctl": "act", "observation": _sendable(observations), "control_steps": self._interface._steps}
        )
        n = self._interface.num_envs
        self.failures = np.broadcast_to(answer.get("failures", 0), n).astype(np.int64)
        errors = {int(i): error_in(str(text)) for i, text in answer.get("errors", {}).items()}
        if len(errors) == n:
            raise ControllersFailed(errors, [None] * n)
        actions = self._checked(answer.get("actions"), (n, *self._shape))
        if errors:
            raise ControllersFailed(errors, [*actions])
        return actions

    def close(self) -> None:
        """End the connection, and the policy's process if it is one of another Python."""
        self._connection.close()
        if self._host is not None:
            self._host.end()

    @property
    def _shape(self) -> tuple[int, ...]:
        return self._interface.single_action_space.shape or ()

    def _act_one(self, world: int, observations: Observations) -> Any:
        """Return the next action of a world's chunk."""
        if not self._chunks[world]:
            observation = _sendable(one_of(observations, world))
            parts = observation if isinstance(observation, dict) else {"observation": observation}
            texts = {name: text for name, text in self._names.items() if name not in parts}
            answer = self._answer({self._names.get(name, name): part for name, part in parts.items()} | texts)
            actions = np.asarray(answer.get("actions"))
            chunk = actions if actions.ndim > len(self._shape) else actions[None]
            self._chunks[world].extend(self._checked(chunk, (len(chunk) or 1, *self._shape)))
        return self._chunks[world].popleft()

    def _answer(self, message: dict[str, Any]) -> dict[str, Any]:
        """Return the answer; take note of the times."""
        start = perf_counter()
        answer = self._connection.ask(message)
        spent = perf_counter() - start
        timing = answer.get("server_timing")  # of openpi's servers
        says = timing.get("infer_ms") if isinstance(timing, dict) else None
        if isinstance(says, (int, float)) and 0 <= says <= 1e3 * spent:
            self._transports.append(spent - says / 1e3)
            spent = says / 1e3
        self.seconds += spent
        return answer

    def _checked(self, actions: Any, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return the actions of an answer. Raises `InvalidAction`."""
        if not isinstance(actions, np.ndarray) or actions.shape != shape:
            returned = f"actions of shape {actions.shape}" if isinstance(actions, np.ndarray) else repr(actions)[:100]
            raise InvalidAction(f"{self._name} answered {returned}; expected are numbers of shape {shape}")
        return actions


def _sendable(observations: Any) -> Any:
    """Return observations as messages hold them."""
    if isinstance(observations, Mapping):
        return {name: _sendable(part) for name, part in observations.items()}
    return np.asarray(observations)


def _as_texts(state: Any) -> Any:
    """Return the state of a random number generator with its numbers of 128 bits as texts."""
    if isinstance(state, dict):
        return {name: _as_texts(value) for name, value in state.items()}
    return str(state)
