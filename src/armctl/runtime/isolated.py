"""The process of an isolated policy, seen from within: it makes the policy, and acts when it is asked.

It gets observations and the policy's interface, and no seed, no episode number and no world. What it sends is JSON: the
process that plays unpickles nothing of it.
"""

import ctypes
import os
import pickle
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np
from pydantic import TypeAdapter

from armctl.agents.costs import TrainingCost
from armctl.core import kinds
from armctl.core.errors import (
    FAILURES,
    AgentFileError,
    ConfigurationError,
    InvalidAction,
    details_of,
    formatted,
)
from armctl.core.plain_values import plain
from armctl.envs import Interface
from armctl.policies import ControllersFailed, Policy, make_policy
from armctl.policies.declare import declared, declared_foresight
from armctl.policies.find import loaded
from armctl.policies.policy import Code
from armctl.runtime.workers import end_with_parent

LONGEST = 100_000
"""Characters of a traceback."""
DIE_WITH_PARENT = 1
"""Number of Linux's `PR_SET_PDEATHSIG`."""

Kind = Literal["error", "action", "configuration", "agent"]

KINDS: dict[type[BaseException], Kind] = {
    InvalidAction: "action",
    AgentFileError: "agent",
    ConfigurationError: "configuration",
}


@dataclass(frozen=True)
class RemoteError:
    """An error that was raised in the process."""

    kind: Kind
    name: str
    """Name of its class."""
    message: str
    """Message, and the place in the user's code."""
    traceback: str
    by_world: dict[int, str] = field(default_factory=dict)

    @classmethod
    def of(cls, error: BaseException) -> "RemoteError":
        """Return what an error says."""
        kind: Kind = next((name for error_type, name in KINDS.items() if isinstance(error, error_type)), "error")
        message = str(error) if kind != "error" else details_of(error)
        by_world = error.by_world if isinstance(error, InvalidAction) else {}
        return cls(kind, type(error).__name__, message, formatted(error)[-LONGEST:], by_world)


@dataclass(frozen=True)
class Answer:
    """Answer to any request; most fields are for some requests only."""

    error: RemoteError | None = None
    """Error, if the request failed as a whole."""
    sees: str = ""
    foresight: tuple[str, ...] = ()
    code: Code | None = None
    reads: tuple[str, ...] | None = None
    training_steps: int = 0
    training_minutes: float | None = None
    training_cost: TrainingCost | None = None
    family: str | None = None
    kind: kinds.Kind | None = None
    seconds: float = 0.0
    """Duration of the policy's construction or call; of the construction, for each of its controllers."""
    errors: dict[int, RemoteError] = field(default_factory=dict)
    """Errors of single controllers, by world."""
    actions: Any = None
    failures: Any = None


ANSWER = TypeAdapter(Answer)


class _Served:
    """The policy of this process."""

    def __init__(self) -> None:
        self._policy: Policy
        self._interface: Interface

    def load(self, source: bytes, name: str) -> Answer:
        """Import a policy's code, and tell what it declares."""
        self._name, self._source = name, pickle.loads(source)
        code = None
        if isinstance(self._source, str) and ":" in self._source:
            from armctl.runtime.identity import code_of

            code = Code(*code_of(self._source))
        factory = loaded(self._source)
        if isinstance(factory, Path):
            return Answer(sees="observation")
        return Answer(sees=declared(factory), foresight=declared_foresight(factory), code=code)

    def make(self, interface: bytes) -> Answer:
        """Make the policy, with an interface."""
        self._interface = pickle.loads(interface)
        start = perf_counter()
        self._policy = policy = make_policy(self._source, self._interface, name=self._name)
        seconds = perf_counter() - start
        cost = getattr(policy, "training_cost", None)
        return Answer(
            sees=policy.sees,
            reads=getattr(policy, "reads", None),
            training_steps=policy.training_steps,
            training_minutes=getattr(policy, "training_minutes", None),
            training_cost=cost if isinstance(cost, TrainingCost) else None,
            family=getattr(policy, "family", None),
            kind=kinds.declared_kind(policy),
            seconds=seconds / len(getattr(policy, "controllers", [policy])),
        )

    def reset(self, ids: Any, episodes: dict[int, dict[str, Any]]) -> Answer:
        """Begin new episodes, with what the interface tells of each."""
        for world, news in episodes.items():
            episode = self._interface._episodes[world]
            episode.rng.bit_generator.state = news.pop("rng")
            vars(episode).update(news)
        return self._timed(lambda: self._policy.reset(ids))

    def act(self, observations: Any, control_steps: Any) -> Answer:
        """Return actions for observations, after so many control steps (n,) of each world's episode."""
        self._interface._steps[:] = control_steps
        return self._timed(lambda: self._policy.act(observations))

    def _timed(self, call: Callable[[], Any]) -> Answer:
        start, errors = perf_counter(), dict[int, RemoteError]()
        try:
            result = call()
        except ControllersFailed as failure:
            result, errors = failure.actions, {i: RemoteError.of(error) for i, error in failure.errors.items()}
        seconds = perf_counter() - start
        failures = plain(np.array(getattr(self._policy, "failures", 0)))
        return Answer(seconds=seconds, errors=errors, actions=plain(result), failures=failures)


def main(descriptor: int, parent: int) -> None:
    """Answer requests until there are no more, or until the parent has ended."""
    ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)  # also while a policy computes, and no thread can watch
    end_with_parent(parent)
    if os.getppid() != parent:
        return
    served, connection = _Served(), Connection(descriptor)
    while True:
        try:
            request, *arguments = pickle.loads(connection.recv_bytes())
        except EOFError:
            return
        try:
            answer = getattr(served, request)(*arguments)
            message = ANSWER.dump_json(answer)
        except FAILURES as error:
            message = ANSWER.dump_json(Answer(error=RemoteError.of(error)))
        connection.send_bytes(message)
