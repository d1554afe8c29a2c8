"""A server of one policy, for comparisons in other processes: see `armctl.policies.remote`."""

import dataclasses
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from armctl import __version__
from armctl.core.errors import ConfigurationError, described
from armctl.core.kinds import declared_kind
from armctl.envs import SEES, CurrentEpisode, Interface, PolicyStreams, interface_of, task_of
from armctl.policies import ControllersFailed, Policy, WorldsByInterface, make_policy
from armctl.policies.declare import declared, declared_foresight
from armctl.policies.find import loaded
from armctl.policies.trainings import card_of
from armctl.remote.host import serve
from armctl.remote.messages import VERSION
from armctl.runtime.identity import code_of

LARGEST_BATCH = 4096
"""Worlds of one connection."""


def serve_policy(
    policy: str, env: str, options: Mapping[str, Any], host: str, port: int, on_ready: Callable[[int], None]
) -> None:
    """Serve a policy for the worlds of an environment until the process ends.

    Each connection has a policy of its own. Raises `ConfigurationError` for a policy that sees more than a model of the
    robot, and what `make_policy` raises.
    """
    interface, interface_options = _interface(policy, env, options)
    served = make_policy(policy, interface)
    metadata = {
        "armctl": VERSION, "version": __version__, "policy": policy, "env": interface.env_id, "sees": served.sees,
        "interface": interface_options, "identity": _identity(policy), "training_steps": served.training_steps,
        "family": getattr(served, "family", policy), "kind": declared_kind(served),
    }  # fmt: skip
    serve(lambda: ServedPolicy(policy, interface, metadata), host, port, on_ready)


class ServedPolicy:
    """The policy of one connection."""

    def __init__(self, name: str, interface: Interface, metadata: dict[str, Any]) -> None:
        self.metadata = metadata
        self._name, self._single = name, interface
        self._interface, self._policy = self._make(1)
        self._began = False

    def answer(self, message: dict[str, Any]) -> dict[str, Any]:
        """Begin episodes in some worlds, or act in all of them, or in the only one. Raises what the policy raises."""
        match message:
            case {"armctl": "begin", "worlds": int(num_envs), "ids": np.ndarray() as ids, "rng": list(states)}:
                self._begin(num_envs, ids, states)
                return {}
            case {"armctl": "act", "observation": observations}:
                self._interface._steps[:] = message.get("control_steps", 0)
                return self._act(observations)
            case {"observation": observation} if "armctl" not in message:  # of openpi's clients
                if not self._began:
                    self._policy.reset(np.zeros(1, np.int32))
                    self._began = True
                return self._act(_in_a_batch(observation))
        raise ConfigurationError('a message has the key "observation", the observation of one world')

    def close(self) -> None:
        """Close nothing."""

    def _begin(self, num_envs: int, ids: Any, states: list[Any]) -> None:
        if not 1 <= num_envs <= LARGEST_BATCH:
            raise ConfigurationError(f"a connection has at most {LARGEST_BATCH} worlds, not {num_envs}")
        if num_envs != self._interface.num_envs:
            self._interface, self._policy = self._make(num_envs)
        for i, state in zip(ids.tolist(), states, strict=True):
            self._interface.rng(i).bit_generator.state = _from_texts(state)
        self._policy.reset(np.asarray(ids, np.int32))
        self._began = True

    def _act(self, observations: Any) -> dict[str, Any]:
        start, errors = perf_counter(), dict[str, str]()
        try:
            actions: Any = self._policy.act(observations)
        except ControllersFailed as failure:
            actions, errors = failure.actions, {str(i): described(error) for i, error in failure.errors.items()}
            valid = next((action for action in actions if action is not None), self._single.idle_action)
            actions = [valid if action is None else action for action in actions]
        spent = perf_counter() - start
        failures = np.broadcast_to(getattr(self._policy, "failures", 0), self._interface.num_envs)
        timing = {"infer_ms": 1e3 * spent}
        return {"actions": np.asarray(actions), "errors": errors, "failures": failures.copy(), "server_timing": timing}

    def _make(self, num_envs: int) -> tuple[Interface, Policy]:
        episodes = [CurrentEpisode(np.random.default_rng(0)) for _ in range(num_envs)]
        steps = np.zeros(num_envs, np.int64)
        interface = dataclasses.replace(self._single, num_envs=num_envs, _episodes=episodes, _steps=steps)
        return interface, make_policy(self._name, interface)


def _interface(policy: str, env: str, options: Mapping[str, Any]) -> tuple[Interface, dict[str, Any]]:
    """Return what a policy is told of an environment, and the options of the interface that it asks for."""
    source = loaded(policy)
    sees = "observation" if isinstance(source, Path) else declared(source)
    if sees not in ("observation", "model") or declared_foresight(source):
        raise ConfigurationError(
            f"{policy} sees the {SEES[sees]}, and only policies that see the {SEES['observation']}, with a model of "
            "the robot or without, can be served: what is true stays with the simulator"
        )
    with closing(WorldsByInterface(env, 1, options)) as interfaces:
        interface = interface_of(interfaces.of(policy), sees, PolicyStreams(policy, 0))
        chosen = {
            name: value
            for name, value in interfaces.options_of(policy).items()
            if name in task_of(env).interface_options
        }
    return interface, chosen


def _identity(policy: str) -> str:
    """Return what determines the policy's answers."""
    card = card_of(policy)
    if card is not None:
        return f"{policy}, {card.sha256}"
    objects, code, _ = code_of(policy)
    return f"{policy}, {objects}, {sorted(code.items())}, armctl {__version__}"


def _in_a_batch(observation: Any) -> Any:
    if isinstance(observation, dict):
        return {name: _in_a_batch(part) for name, part in observation.items()}
    return np.asarray(observation)[None]


def _from_texts(state: Any) -> Any:
    """Return the state of a random number generator, whose numbers came as texts."""
    if isinstance(state, dict):
        return {name: _from_texts(value) for name, value in state.items()}
    return int(state) if str(state).isdigit() else state
