"""Isolated policies: each in a process of its own, which gets observations only; seen from the process that plays.

That process has no world, no seed and no episode number, in no frame and no object; see `armctl.runtime.isolated`, and
for what this does not protect against, `SECURITY.md`.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import weakref
from collections.abc import Iterable
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from armctl.core.errors import AgentFileError, ArmctlError, ConfigurationError, InvalidAction
from armctl.core.plain_values import restored
from armctl.core.registration import remember_named
from armctl.envs import SEES, EpisodeVectorEnv, Interface, PolicyStreams, interface_of
from armctl.policies import Actions, ControllersFailed, configured, policy_names
from armctl.policies.names import agent_cards, declared_sees, without_filter
from armctl.policies.policy import Code, PlaysApart
from armctl.policies.trainings import card_of
from armctl.remote.names import is_remote
from armctl.runtime.isolated import ANSWER, Answer, RemoteError
from armctl.tasks import Observations

PATIENCE = 300.0
"""s that a policy may take for each request before it counts as hanging."""
LARGEST_MESSAGE = 2**28
"""Bytes of an answer."""
START = "import sys; sys.path[:] = {path!r}; from armctl.runtime.isolated import main; main({descriptor}, {parent})"


class PolicyProcessFailed(ArmctlError):
    """The process of an isolated policy has died, hangs, or answered what is none of armctl's messages."""


class IsolatedPolicy:
    """A policy that plays in a process of its own. A process that died is replaced at the next reset."""

    def __init__(self, source: Any, name: str, interface: Interface, process: "_Process", loaded: Answer) -> None:
        self._source, self._name, self._interface, self._process = source, name, interface, process
        built = self._build()
        self.sees: Any = built.sees if card_of(source) is not None else loaded.sees
        self.foresight = loaded.foresight
        self.code: Code | None = loaded.code
        """Code that only the policy's process has imported; None: all of it is known here."""
        self.construction_ms = round(1e3 * built.seconds, 4)
        self.training_steps, self.training_minutes = built.training_steps, built.training_minutes
        self.training_cost, self.family, self.kind = built.training_cost, built.family, built.kind
        if built.reads is not None:
            self.reads = built.reads
        self.patience = PATIENCE
        """Time that its process may take for an answer, s."""
        self.seconds = 0.0
        """Duration of the last call, as measured around it in the policy's process."""
        self.failures: NDArray[np.int64] = np.zeros(interface.num_envs, dtype=np.int64)

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`. Raises `ControllersFailed`, and whatever the policy raises."""
        if not self._process.is_running:
            self._process = _Process(self._name)
            self._process.load(self._source)
            self._build()
        episodes = {}
        for i in ids.tolist():
            episode = self._interface._episodes[i]
            episodes[i] = {**vars(episode), "rng": episode.rng.bit_generator.state}
        self._answered("reset", ids, episodes)

    def act(self, observations: Observations) -> Actions:
        """Return actions (n, ...). Raises `ControllersFailed`, and whatever the policy raises."""
        return self._answered("act", observations, self._interface._steps)  # type: ignore[no-any-return]

    def close(self) -> None:
        """End the process. The next reset begins another."""
        self._process.end()

    def _build(self) -> Answer:
        return self._process.ask("make", cloudpickle.dumps(self._interface))

    def _answered(self, request: str, *arguments: Any) -> Any:
        answer = self._process.ask(request, *arguments, patience=self.patience)
        self.seconds = answer.seconds
        with self._process.wrap_nonsense():
            self.failures = np.broadcast_to(restored(answer.failures), self._interface.num_envs).astype(np.int64)
            actions = restored(answer.actions)
        if answer.errors:
            raise ControllersFailed({i: _raised(error) for i, error in answer.errors.items()}, actions)
        return actions


def isolated(policy: Any, env: EpisodeVectorEnv, name: str, policy_seed: int) -> IsolatedPolicy | None:
    """Make a policy in a process of its own, without importing its code here; see `make_policy`.

    None: it is one of the installed policies that see the true state, which no other process has, or it is in another
    process already.

    Raises `ConfigurationError` for any other policy that sees it, and what `make_policy` raises.
    """
    source: Any = str(policy) if isinstance(policy, Path) else policy
    if without_filter(source) != source:
        raise ConfigurationError(
            f"{name} cannot be isolated: its filter sees the {SEES['state']}, which only the process that plays has"
        )
    if is_remote(source):
        return None
    card = agent_cards().get(source) if isinstance(source, str) else None
    process = _Process(name)
    try:
        loaded = process.load(source if card is None else str(card))
        if loaded.sees == "state":
            process.end()
            if isinstance(source, str) and (source in policy_names() or configured(source) is not None):
                return None
            raise ConfigurationError(
                f"{name} sees the {SEES['state']}, which only the process that plays has: it cannot be isolated"
            )
        if isinstance(source, str) and ":" in source:
            remember_named(source)
        interface = interface_of(env, loaded.sees, PolicyStreams(name, policy_seed), loaded.foresight)
        actor = IsolatedPolicy(source if card is None else str(card), name, interface, process, loaded)
        if card is not None:
            actor.sees = declared_sees(source)
        return actor
    except (PolicyProcessFailed, KeyError, RuntimeError) as error:
        raise ConfigurationError(f"{name} could not be made: {error}") from error


def close(policies: Iterable[Any]) -> None:
    """End the processes of those policies that play in others, and connections to servers."""
    for policy in policies:
        if isinstance(policy, PlaysApart):
            policy.close()


class _Process:
    """A process of an isolated policy called `name`. It ends with this one, however that ends, or if it is garbage."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._connection, theirs = Pipe()
        descriptor = theirs.fileno()
        code = START.format(path=sys.path, descriptor=descriptor, parent=os.getpid())
        self._process = subprocess.Popen([sys.executable, "-c", code], pass_fds=[descriptor], process_group=0)
        theirs.close()
        self._end = weakref.finalize(self, _end, self._process, self._connection)

    @property
    def is_running(self) -> bool:
        """True unless it has died or was ended."""
        return self._end.alive and self._process.poll() is None

    def end(self) -> None:
        """Kill it."""
        self._end()

    def load(self, source: Any) -> Answer:
        """Let it import a policy's code; return what that declares."""
        try:
            packed = cloudpickle.dumps(source)
        except Exception as error:  # pickling an object may raise anything
            raise ConfigurationError(
                f"{self._name} cannot be sent to a process of its own ({error}): use a function that makes it, or its "
                "module:function"
            ) from error
        return self.ask("load", packed, self._name)

    def ask(self, request: str, *arguments: Any, patience: float = PATIENCE) -> Answer:
        """Return its answer. Raises the error that it tells, and `PolicyProcessFailed`."""
        try:
            dumps = pickle.dumps if request == "act" else cloudpickle.dumps  # objects of a script travel by value
            self._connection.send_bytes(dumps((request, *arguments), pickle.HIGHEST_PROTOCOL))
            if not self._connection.poll(patience):
                self.end()
                raise PolicyProcessFailed(f"its process has not answered for {patience:g} s, and was ended")
            message = self._connection.recv_bytes(LARGEST_MESSAGE)
        except (EOFError, OSError) as error:
            raise PolicyProcessFailed(f"its process {self._way_of_dying()}") from error
        with self.wrap_nonsense():
            answer = ANSWER.validate_json(message)
        if answer.error is not None:
            raise _raised(answer.error)
        return answer

    @contextlib.contextmanager
    def wrap_nonsense(self) -> Any:
        """End a process whose answer cannot be read. Raises `PolicyProcessFailed`."""
        try:
            yield
        except (ValidationError, ValueError, TypeError, RecursionError, OverflowError) as error:
            self.end()
            raise PolicyProcessFailed("its process answered what is none of armctl's messages") from error

    def _way_of_dying(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        status = self._process.returncode
        self.end()
        if status is None:
            return "closed its connection"
        return f"died by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"


def _end(process: "subprocess.Popen[bytes]", connection: Connection) -> None:
    connection.close()
    process.kill()
    process.wait()


def _raised(remote: RemoteError) -> BaseException:
    """Return an error that reads like the one in the policy's process."""
    error: BaseException
    if remote.kind == "action":
        error = InvalidAction(remote.message, remote.by_world)
    elif remote.kind == "error":
        error = type(remote.name, (Exception,), {})(remote.message)
    else:
        error = {"agent": AgentFileError, "configuration": ConfigurationError}[remote.kind](remote.message)
    error.add_note(f"In the policy's own process:\n{remote.traceback}")
    return error
