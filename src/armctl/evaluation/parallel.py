"""Plays blocks of episodes: one after the other in this process, or in parallel in several, through joblib.

By default, joblib starts processes on this machine (loky). Wrap a comparison in `joblib.parallel_config` to use a
cluster's backend instead.
"""

import contextlib
import functools
import os
import signal
import threading
import time
import uuid
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

import cloudpickle
import joblib
from joblib.parallel import LokyBackend, get_active_backend

from armctl.envs import EpisodeVectorEnv
from armctl.errors import ArmctlError, ConfigurationError, EnvironmentFailed, format_cause
from armctl.evaluation.decision_times import TimedPolicy
from armctl.evaluation.real_time import RealTime, RealTimePolicy
from armctl.evaluation.record import EpisodeResult
from armctl.evaluation.rollouts import PolicyDisqualified, PolicyFailed, rollouts
from armctl.policies import Policy, PolicyFactory, WorldsByInterface, make_policy

ROUNDS = 4
"""Episodes per world in a block. With so many, little time is lost waiting for the last episodes of a block."""

PARENT_CHECK = 1.0
"""s between two looks of a worker whether its parent still lives."""


class WorkersFailed(ArmctlError):
    """A worker process died, or could not load what it was sent."""


@dataclass(frozen=True)
class WorkerConfig:
    """The environment in which all policies play; each worker makes it once."""

    env: str = field(compare=False)
    worlds: int = field(compare=False)
    env_options: Mapping[str, Any] = field(compare=False)
    seed: int = field(compare=False)
    workers: int = field(compare=False, default=1)
    home: int = field(default_factory=os.getpid, compare=False)
    """Id of the process that waits for the workers."""
    key: str = field(default_factory=lambda: uuid.uuid4().hex)


@dataclass(frozen=True)
class RolloutBatch:
    """Results of some of a policy's episodes."""

    policy: str
    results: list[EpisodeResult]
    failure: str | None = None
    """Error message, if the policy or the environment failed after these."""
    traceback: str = ""
    disqualified: bool = False
    """Whether the policy wrote to the world, so that none of its episodes count."""


def play_here(
    policies: Mapping[str, Policy],
    worlds: Mapping[str, EpisodeVectorEnv],
    seed: int,
    waiting: Mapping[str, Sequence[int]],
    least_lengths: dict[int, float],
    real_time: RealTime | None = None,
) -> Generator[RolloutBatch, None, None]:
    """Play each policy's `waiting` episodes in its `worlds`, and yield each as it ends.

    `least_lengths` is as in `rollouts`. In real time, policies have one world each.
    """
    for name, policy in policies.items():
        if not waiting[name]:
            continue
        try:
            env = worlds[name]
            timed = RealTimePolicy(policy, env, real_time, name) if real_time else policy
            for result in rollouts(timed, env, waiting[name], seed, name, least_lengths):
                yield RolloutBatch(name, [result])
        except (PolicyFailed, EnvironmentFailed) as failure:
            yield _failed(name, [], failure)


def play_in_workers(
    policies: Mapping[str, str | PolicyFactory],
    config: WorkerConfig,
    waiting: Mapping[str, Sequence[int]],
    least_lengths: dict[int, float],
    workers: int,
    real_time: RealTime | None = None,
) -> Generator[RolloutBatch, None, None]:
    """The same in `workers` processes, by blocks of episodes. Closing the iterator discards unfinished blocks.

    Raises `WorkersFailed`.
    """
    failed: set[str] = set()

    def blocks() -> Iterator[Any]:
        for name, policy in policies.items():
            for block in _blocks(waiting[name], config.worlds, workers):
                if name not in failed:
                    known = {episode: least_lengths[episode] for episode in block if episode in least_lengths}
                    late = real_time and real_time.of(name, block)
                    yield joblib.delayed(_play)(config, name, policy, block, known, late)

    parallel = joblib.Parallel(n_jobs=workers, return_as="generator_unordered", **_ending_with_this_process())
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
        except Exception as error:  # pickling an object may raise anything
            raise ConfigurationError(
                f"{name} cannot be sent to worker processes ({error}): use a function that makes it, its "
                "module:function, or a single worker"
            ) from error


def _ending_with_this_process() -> dict[str, Any]:
    """Arguments for loky, whose workers would outlive a killed parent by minutes. A cluster's are not children."""
    backend, _ = get_active_backend()
    return {"initializer": _begin, "initargs": (os.getpid(),)} if isinstance(backend, LokyBackend) else {}


def _begin(parent: int) -> None:
    """Let this worker end when its parent has gone, however that ended, and not by Ctrl-C before."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(PARENT_CHECK)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _blocks(episodes: Sequence[int], worlds: int, workers: int) -> Iterator[Sequence[int]]:
    """Blocks small enough that every worker gets one; of one episode if one world plays (joblib groups those)."""
    size = 1 if worlds == 1 else max(1, min(ROUNDS * worlds, -(-len(episodes) // workers)))
    return (episodes[i : i + size] for i in range(0, len(episodes), size))


def _play(
    config: WorkerConfig,
    name: str,
    policy: str | PolicyFactory,
    episodes: Sequence[int],
    least_lengths: dict[int, float],
    real_time: RealTime | None,
) -> RolloutBatch:
    """Play a block of episodes in a worker."""
    if os.getpid() != config.home:
        with contextlib.suppress(ValueError):  # threads of a cluster's worker get no signals
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the process that waits
    worlds, timed = _worlds(config).of(policy), _made(config, name, policy)
    if real_time:
        timed = RealTimePolicy(timed.policy, worlds, real_time, name)
    results: list[EpisodeResult] = []
    try:
        results.extend(rollouts(timed, worlds, episodes, config.seed, name, least_lengths))
    except (PolicyFailed, EnvironmentFailed) as failure:
        return _failed(name, results, failure)
    return RolloutBatch(name, results)


def _failed(name: str, results: list[EpisodeResult], failure: PolicyFailed | EnvironmentFailed) -> RolloutBatch:
    disqualified = isinstance(failure, PolicyDisqualified)
    return RolloutBatch(name, results, str(failure), format_cause(failure), disqualified)


_policies: dict[tuple[WorkerConfig, str], TimedPolicy] = {}


@functools.lru_cache(maxsize=1)
def _worlds(config: WorkerConfig) -> WorldsByInterface:
    _policies.clear()
    return WorldsByInterface(config.env, config.worlds, config.env_options, threads=1)


def _made(config: WorkerConfig, name: str, policy: str | PolicyFactory) -> TimedPolicy:
    worlds = _worlds(config).of(policy)
    if (config, name) not in _policies:
        _policies[config, name] = TimedPolicy(make_policy(policy, worlds), worlds.num_envs, config.workers)
    return _policies[config, name]
