"""Plays blocks of episodes: one after the other in this process, or in parallel by an engine's workers."""

import contextlib
import os
import signal
import uuid
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import cloudpickle

from armctl.agents import FILES
from armctl.core.errors import ConfigurationError, EnvironmentFailed, format_cause
from armctl.envs import EpisodeVectorEnv
from armctl.episodes.failures import FirstEpisodes, PolicyDisqualified, PolicyFailed, until_unplayable
from armctl.episodes.record import EpisodeResult
from armctl.policies import Policy, PolicyFactory, WorldsByInterface, configured
from armctl.policies.trainings import training_card
from armctl.rollout.decision_times import TimedPolicy
from armctl.rollout.real_time import RealTime, RealTimePolicy
from armctl.rollout.rollouts import build_timed, rollouts
from armctl.runtime.engines import Cluster, Engine
from armctl.runtime.identity import LOADED, identity
from armctl.runtime.sending import relative
from armctl.runtime.workers import Work, check_alike

ROUNDS = 4
"""Episodes per world in a block. With so many, little time is lost waiting for the last episodes of a block."""


class Interfaces(Protocol):
    """Worlds by what plays in them."""

    def of(self, policy: Any) -> EpisodeVectorEnv:
        """Those of a policy."""

    def close(self) -> None:
        """Close all of them."""


@dataclass(frozen=True)
class WorkerConfig:
    """The environment in which all policies play; each worker makes it once for each policy."""

    env: str = field(compare=False)
    worlds: int = field(compare=False)
    env_options: Mapping[str, Any] = field(compare=False)
    seed: int = field(compare=False)
    policy_seed: int = field(compare=False, repr=False)
    """Secret from which policies draw their random numbers (see `armctl.envs.policy_seed`)."""
    workers: int = field(compare=False, default=1)
    home: int = field(default_factory=os.getpid, compare=False)
    """Id of the process that waits for the workers."""
    interfaces: Callable[..., Interfaces] = field(default=WorldsByInterface, compare=False)
    """What makes the worlds, of armctl's."""
    key: str = field(default_factory=lambda: uuid.uuid4().hex)


@dataclass(frozen=True)
class Setting:
    """What all blocks of a comparison share."""

    config: WorkerConfig
    policies: Mapping[str, str | Path | PolicyFactory]
    identities: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """What determines each policy's episodes, to be found alike on other machines."""


@dataclass(frozen=True)
class RolloutBatch:
    """Results of some of a policy's episodes."""

    policy: str
    results: list[Any]
    """An `EpisodeResult` of each, or what else `batch` was to yield."""
    failure: str | None = None
    """Error message, if the policy or the environment failed after these."""
    traceback: str = ""
    disqualified: bool = False
    """Whether the policy wrote to the world, so that none of its episodes count."""
    construction_ms: float | None = None
    """How long it took to make the policy in the worker."""


def play_here(
    policies: Mapping[str, Policy],
    worlds: Mapping[str, EpisodeVectorEnv],
    seed: int,
    waiting: Mapping[str, Sequence[int]],
    least_lengths: dict[int, float],
    real_time: RealTime | None = None,
    finished: Collection[str] = (),
) -> Generator[RolloutBatch, None, None]:
    """Play each policy's `waiting` episodes in its `worlds`, and yield each as it ends.

    `least_lengths` is as in `rollouts`. In real time, policies have one world each. A policy that has `finished`
    episodes before can play; one that cannot play at all stops (see `armctl.episodes.failures`).
    """
    for name, policy in policies.items():
        if not waiting[name]:
            continue
        try:
            env = worlds[name]
            timed = RealTimePolicy(policy, env, real_time, name) if real_time else policy
            results = rollouts(timed, env, waiting[name], seed, name, least_lengths)
            for result in until_unplayable(results, name, () if name in finished else waiting[name]):
                yield RolloutBatch(name, [result])
        except (PolicyFailed, EnvironmentFailed) as failure:
            yield failed(name, [], failure)


def play_in_workers(
    setting: Setting,
    made: Mapping[str, Policy],
    worlds: Interfaces,
    waiting: Mapping[str, Sequence[int]],
    least_lengths: dict[int, float],
    engine: Engine,
    real_time: RealTime | None = None,
    finished: Collection[str] = (),
) -> Generator[RolloutBatch, None, None]:
    """The same by an engine's workers; see `do_in_workers`."""
    first = {name: FirstEpisodes(name, () if name in finished else waiting[name]) for name in made}

    def known(name: str, block: Sequence[int]) -> tuple[Any, ...]:
        least = {episode: least_lengths[episode] for episode in block if episode in least_lengths}
        return least, real_time and real_time.of(name, block)

    def counted(played: RolloutBatch) -> RolloutBatch:
        results: list[EpisodeResult] = []
        try:
            for result in played.results:
                results += first[played.policy].counted(result)
        except PolicyFailed as failure:
            return failed(played.policy, results, failure)
        return replace(played, results=results)

    with closing(do_in_workers(_play, setting, made, worlds, waiting, engine, known, counted)) as everything:
        for played in everything:
            least_lengths.update((result.episode, result.least_length) for result in played.results)
            yield played


def do_in_workers(
    work: Work,
    setting: Setting,
    made: Mapping[str, Policy],
    worlds: Interfaces,
    waiting: Mapping[str, Sequence[int]],
    engine: Engine,
    more: Callable[[str, Sequence[int]], tuple[Any, ...]] = lambda name, block: (),
    counted: Callable[[RolloutBatch], RolloutBatch] = lambda played: played,
) -> Generator[RolloutBatch, None, None]:
    """Yield `work(setting, name, block, *more(name, block))` for blocks of each policy's `waiting` episodes.

    `made` are the setting's policies, as made here in `worlds`. `counted` says what counts of a block, or that its
    policy has failed: then no more of its blocks are begun. Closing the iterator discards unfinished blocks. Raises
    `WorkersFailed`.
    """
    failed: set[str] = set()

    def blocks() -> Iterator[Any]:
        for name in setting.policies:
            for block in _blocks(waiting[name], setting.config.worlds, engine):
                if name not in failed:
                    yield name, block, *more(name, block)

    if isinstance(engine, Cluster):
        sent, files = _for_sending(setting, made, worlds)
        everything = engine.run(work, sent, blocks(), files)
    else:
        alone = {name: replace(setting, policies={name: policy}) for name, policy in setting.policies.items()}
        everything = engine.run(_do_alone, work, ((alone[block[0]], *block) for block in blocks()))
    with closing(everything):
        for played in map(counted, everything):
            if played.failure:
                if played.policy in failed:
                    continue
                failed.add(played.policy)
            yield played


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


def _blocks(episodes: Sequence[int], worlds: int, engine: Engine) -> Iterator[Sequence[int]]:
    """Blocks small enough that every worker gets one; of one episode if one world plays and the engine groups those."""
    size = (
        1 if worlds == 1 and engine.groups_units else max(1, min(ROUNDS * worlds, -(-len(episodes) // engine.workers)))
    )
    return (episodes[i : i + size] for i in range(0, len(episodes), size))


def _do_alone(work: Work, setting: Setting, *block: Any) -> Any:
    """Do a block in a worker to which the setting is sent with each block, with no other policy then."""
    return work(setting, *block)


def _play(
    setting: Setting,
    name: str,
    episodes: Sequence[int],
    least_lengths: dict[int, float],
    real_time: RealTime | None,
) -> RolloutBatch:
    """Play a block of episodes in a worker."""

    def play(timed: TimedPolicy, worlds: EpisodeVectorEnv) -> Iterator[EpisodeResult]:
        policy = RealTimePolicy(timed.policy, worlds, real_time, name) if real_time else timed
        return rollouts(policy, worlds, episodes, setting.config.seed, name, least_lengths)

    return batch(setting, name, play)


def batch(setting: Setting, name: str, play: Callable[[TimedPolicy, EpisodeVectorEnv], Iterable[Any]]) -> RolloutBatch:
    """In a worker: all that `play` yields with a policy in its worlds, until it fails."""
    if os.getpid() != setting.config.home:
        with contextlib.suppress(ValueError):  # threads of a cluster's worker get no signals
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the process that waits
    results: list[Any] = []
    try:
        worlds, timed = _made(setting, name)
        results.extend(play(timed, worlds))
    except (PolicyFailed, EnvironmentFailed) as failure:
        return failed(name, results, failure)
    return RolloutBatch(name, results, construction_ms=timed.construction_ms)


def failed(name: str, results: list[Any], failure: PolicyFailed | EnvironmentFailed) -> RolloutBatch:
    """The results of a policy up to its failure, with the reason."""
    disqualified = isinstance(failure, PolicyDisqualified)
    return RolloutBatch(name, results, str(failure), format_cause(failure), disqualified)


_present: dict[tuple[WorkerConfig, str], tuple[Interfaces, EpisodeVectorEnv, TimedPolicy]] = {}
"""In a worker: the policy that plays at present, with its worlds."""


def _made(setting: Setting, name: str) -> tuple[EpisodeVectorEnv, TimedPolicy]:
    """A policy in worlds of its own, in which no other one has begun an episode or written anything."""
    config, policy = setting.config, setting.policies[name]
    if (config, name) not in _present:
        while _present:
            _present.popitem()[1][0].close()
        interfaces = config.interfaces(config.env, config.worlds, config.env_options, threads=1)
        worlds = interfaces.of(policy)
        made, construction_ms = build_timed(policy, worlds, name, config.policy_seed)
        if expected := setting.identities.get(name):
            check_alike(expected, _known_there(setting, name, made, worlds))
        timed = TimedPolicy(made, worlds.num_envs, config.workers)
        timed.construction_ms = construction_ms
        _present[config, name] = interfaces, worlds, timed
    return _present[config, name][1:]


def _for_sending(setting: Setting, made: Mapping[str, Policy], worlds: Interfaces) -> tuple[Setting, list[Path]]:
    """The setting as another machine can use it, and the files that it names."""
    config, files = setting.config, []
    options, policies = dict(config.env_options), dict(setting.policies)
    for name, value in options.items():
        if isinstance(value, (str, Path)) and os.path.isfile(value):
            files.append(Path(value))
            options[name] = type(value)(relative(str(value)))
    for name, policy in policies.items():
        if isinstance(policy, (str, Path)):
            if (card := training_card(str(policy)) or Path(policy)).suffix in FILES:
                files += [card.with_suffix(suffix) for suffix in FILES if card.with_suffix(suffix).exists()]
                policies[name] = relative(str(card))
            else:
                policies[name] = relative(str(policy))
                files += _file_named(str(policy))
    files += _file_named(config.env)
    sent = Setting(replace(config, env=relative(config.env), env_options=options), policies)
    alike = {name: _known_there(sent, name, policy, worlds.of(setting.policies[name])) for name, policy in made.items()}
    return replace(sent, identities=alike), files


def _file_named(name: str) -> list[Path]:
    """The file of `path/to/file.py:NAME` or `path/to/options.toml`, none of another name."""
    if configured(name) is not None:
        return [Path(name)]
    path = Path(name.rpartition(":")[0])
    return [path] if path.suffix == ".py" else []


def _known_there(setting: Setting, name: str, made: Policy, worlds: EpisodeVectorEnv) -> dict[str, Any]:
    """What determines a policy's episodes, but for what is sent: own code and objects."""
    config, policy = setting.config, setting.policies[name]
    known = identity(config.env, config.env_options, config.seed, {name: policy}, {name: made}, worlds)
    installed = isinstance(policy, str) and ":" not in policy and ":" not in config.env
    sent = {"objects", "makers", LOADED} | (set() if installed else {"code", "registered", "constants"})
    return {key: value for key, value in known.items() if key not in sent}
