"""Policies times blocks of episodes: one after the other in this process, or side by side in several through joblib.

Processes on this machine (loky) are joblib's default; `joblib.parallel_config` around a comparison puts a cluster's
backend in their place.
"""

import contextlib
import functools
import os
import signal
import uuid
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import cloudpickle
import joblib

from armctl.envs import TaskVectorEnv, make_worlds
from armctl.errors import ArmctlError, ConfigurationError
from armctl.evaluation.record import EpisodeResult
from armctl.evaluation.rollouts import PolicyFailed, rollouts
from armctl.policies import Policy, PolicyFactory, make_policy

ROUNDS = 4
"""Of all worlds in a block: what the longest episode of the last round makes others wait for is a small part of it."""


class WorkersFailed(ArmctlError):
    """A worker process died, or could not load what it was sent."""


@dataclass(frozen=True)
class WorkerConfig:
    """Where all policies play; each worker makes it once."""

    env: str = field(compare=False)
    worlds: int = field(compare=False)
    env_options: Mapping[str, Any] = field(compare=False)
    seed: int = field(compare=False)
    home: int = field(default_factory=os.getpid, compare=False)
    """The process that waits for the workers."""
    key: str = field(default_factory=lambda: uuid.uuid4().hex)


@dataclass(frozen=True)
class RolloutBatch:
    """What has come of some of a policy's episodes."""

    policy: str
    results: list[EpisodeResult]
    failure: str | None = None
    """Why there are no more."""


def play_here(
    policies: Mapping[str, Policy],
    env: TaskVectorEnv,
    seed: int,
    waiting: Mapping[str, Sequence[int]],
    least_lengths: dict[int, float],
) -> Generator[RolloutBatch, None, None]:
    """Play each policy's `waiting` episodes, and yield each as it ends; `least_lengths` as in `rollouts`."""
    for name, policy in policies.items():
        if not waiting[name]:
            continue
        try:
            for result in rollouts(policy, env, waiting[name], seed, name, least_lengths):
                yield RolloutBatch(name, [result])
        except PolicyFailed as failure:
            yield RolloutBatch(name, [], str(failure))


def play_in_workers(
    policies: Mapping[str, str | PolicyFactory],
    setting: WorkerConfig,
    waiting: Mapping[str, Sequence[int]],
    least_lengths: dict[int, float],
    workers: int,
) -> Generator[RolloutBatch, None, None]:
    """The same in so many processes, by blocks of episodes; blocks in hand when the iterator is closed are lost.

    Raises `WorkersFailed`.
    """
    failed: set[str] = set()

    def blocks() -> Iterator[Any]:
        for name, policy in policies.items():
            for block in _blocks(waiting[name], setting.worlds, workers):
                if name not in failed:
                    known = {episode: least_lengths[episode] for episode in block if episode in least_lengths}
                    yield joblib.delayed(_play)(setting, name, policy, block, known)

    parallel = joblib.Parallel(n_jobs=workers, return_as="generator_unordered")
    try:
        with closing(parallel(blocks())) as everything:
            for played in everything:
                least_lengths.update((result.episode, result.least_length) for result in played.results)
                if played.failure:
                    if played.policy in failed:
                        continue
                    failed.add(played.policy)
                yield played
    except BrokenProcessPool as error:
        raise WorkersFailed(f"a worker process died, or could not load what it was sent: {error}") from error


def check_sendable(policies: Mapping[str, Any]) -> None:
    """Raise `ConfigurationError` for a policy that cannot be sent to another process."""
    for name, policy in policies.items():
        try:
            cloudpickle.dumps(policy)
        except Exception as error:  # whatever an object's own pickling may raise
            raise ConfigurationError(
                f"{name} cannot be sent to worker processes ({error}): give a function that makes it, its "
                "module:function, or no workers"
            ) from error


def _blocks(episodes: Sequence[int], worlds: int, workers: int) -> Iterator[Sequence[int]]:
    """Blocks small enough for all workers to have one; of one episode, where one world plays (joblib groups those)."""
    size = 1 if worlds == 1 else max(1, min(ROUNDS * worlds, -(-len(episodes) // workers)))
    return (episodes[i : i + size] for i in range(0, len(episodes), size))


def _play(
    setting: WorkerConfig,
    name: str,
    policy: str | PolicyFactory,
    episodes: Sequence[int],
    least_lengths: dict[int, float],
) -> RolloutBatch:
    """A worker's work."""
    if os.getpid() != setting.home:
        with contextlib.suppress(ValueError):  # threads of a cluster's worker get no signals
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C is for the process that waits
    worlds, made = _worlds(setting), _made(setting, name, policy)
    results: list[EpisodeResult] = []
    try:
        results.extend(rollouts(made, worlds, episodes, setting.seed, name, least_lengths))
    except PolicyFailed as failure:
        return RolloutBatch(name, results, str(failure))
    return RolloutBatch(name, results)


_policies: dict[tuple[WorkerConfig, str], Policy] = {}


@functools.lru_cache(maxsize=1)
def _worlds(setting: WorkerConfig) -> TaskVectorEnv:
    _policies.clear()
    return make_worlds(setting.env, setting.worlds, setting.env_options, threads=1)


def _made(setting: WorkerConfig, name: str, policy: str | PolicyFactory) -> Policy:
    worlds = _worlds(setting)
    if (setting, name) not in _policies:
        _policies[setting, name] = make_policy(policy, worlds)
    return _policies[setting, name]
