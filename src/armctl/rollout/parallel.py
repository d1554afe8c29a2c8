"""Blocks of episodes: played one after the other in this process, or in parallel by an engine's workers."""

import contextlib
import os
import signal
import sys
import uuid
from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cloudpickle

from armctl.agents import FILES
from armctl.core.errors import ConfigurationError, EnvironmentFailed, format_cause
from armctl.envs import EpisodeVectorEnv
from armctl.envs.find import maker_in_script
from armctl.episodes.failures import FirstEpisodes, PolicyDisqualified, PolicyFailed, until_unplayable
from armctl.episodes.record import EpisodeResult
from armctl.policies import SUFFIX, Policy, PolicyFactory, WorldsByInterface, is_code
from armctl.policies.policy import PlaysApart
from armctl.policies.trainings import training_card
from armctl.rollout.construction import build_timed
from armctl.rollout.decision_times import TimedPolicy
from armctl.rollout.loop import rollouts
from armctl.rollout.real_time import RealTime, RealTimePolicy
from armctl.runtime.engines import Cluster, Engine
from armctl.runtime.identity import LOADED, identity
from armctl.runtime.sending import relative
from armctl.runtime.workers import check_same_identity

ROUNDS = 4
"""Episodes per world in a block. With so many, little time is lost waiting for the last episodes of a block."""


@dataclass(frozen=True)
class WorkerConfig:
    """The environment in which all policies play; each worker makes it once for each policy."""

    env: str = field(compare=False)
    num_envs: int = field(compare=False)
    env_options: Mapping[str, Any] = field(compare=False)
    seed: int = field(compare=False)
    policy_seed: int = field(compare=False, repr=False)
    """Secret from which policies draw their random numbers (see `armctl.envs.policy_seed`)."""
    workers: int = field(compare=False, default=1)
    isolate: bool = field(compare=False, default=False)
    """True if each policy plays in a process of its own, besides the worker."""
    timeout: float | None = field(compare=False, default=None)
    """Time (s) that a call of a policy or environment may take; None: the default of its kind."""
    home: int = field(default_factory=os.getpid, compare=False)
    """Id of the process that waits for the workers."""
    interfaces: Callable[..., WorldsByInterface] = field(default=WorldsByInterface, compare=False)
    """Class of the worlds."""
    recording: Callable[[EpisodeVectorEnv], Any] | None = field(default=None, compare=False)
    """Wrapper of the worlds that records their episodes."""
    alternating: bool = field(default=False, compare=False)
    """True if all policies play in turns, so that a worker keeps each with its worlds."""
    maker: Any = field(init=False, compare=False)
    """Class or function of the script that makes the environment; None: it can be found by its name."""
    key: str = field(default_factory=lambda: uuid.uuid4().hex)

    def __post_init__(self) -> None:
        object.__setattr__(self, "maker", maker_in_script(self.env))


@dataclass(frozen=True)
class Setting:
    """The common part of all blocks of a cell."""

    config: WorkerConfig
    policies: Mapping[str, str | Path | PolicyFactory]
    identities: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Identity of each policy's episodes, which has to be the same on other machines."""


@dataclass(frozen=True)
class RolloutBatch:
    """Results of some of a policy's episodes."""

    policy: str
    results: list[EpisodeResult]
    failure: str | None = None
    """Error message, if the policy or the environment failed after these."""
    traceback: str = ""
    disqualified: bool = False
    """True if the policy wrote to the world, so that none of its episodes count."""
    construction_ms: float | None = None
    """Time to make the policy in the worker."""
    remarks: tuple[str, ...] = ()
    """Remarks on what the worlds have returned so far."""


UNITS_PER_WORKER = 3
"""Policies per worker from which on none is divided among workers: each saves worlds, and steps more at once."""


def sharing(num_policies: int, workers: int) -> int:
    """Return the number of workers among which the episodes of each of so many policies are divided."""
    return 1 if num_policies >= UNITS_PER_WORKER * workers else workers


def play_here(
    policies: Mapping[str, TimedPolicy],
    worlds: Mapping[str, EpisodeVectorEnv],
    seed: int,
    waiting: Mapping[str, Sequence[int]],
    lower_bound_steps: dict[int, float],
    finished: Collection[str] = (),
) -> Generator[RolloutBatch, None, None]:
    """Play each policy's `waiting` episodes in its `worlds`, and yield each as it ends.

    `lower_bound_steps` is as in `rollouts`. A policy that has `finished` episodes before can play; one that cannot play
    at all stops (see `armctl.episodes.failures`).
    """
    for name, policy in policies.items():
        if not waiting.get(name):
            continue
        try:
            env = worlds[name]
            results = rollouts(policy, env, waiting[name], seed, name, lower_bound_steps)
            for result in until_unplayable(results, name, () if name in finished else waiting[name]):
                yield RolloutBatch(name, [result], remarks=tuple(env.unwrapped.remarks))
        except (PolicyFailed, EnvironmentFailed) as failure:
            yield failed(name, [], failure)


def play_in_workers(
    setting: Setting,
    actors: Mapping[str, Policy],
    worlds: WorldsByInterface,
    waiting: Mapping[str, Sequence[int]],
    lower_bound_steps: dict[int, float],
    engine: Engine,
    real_time: RealTime | None = None,
    finished: Collection[str] = (),
) -> Generator[RolloutBatch, None, None]:
    """Do the same by an engine's workers, block by block, in the order of `waiting`.

    `actors` are the setting's policies, as made here in `worlds`. Of a policy that has failed, no more blocks are
    begun. Closing the iterator discards unfinished blocks. Raises `WorkersFailed`.
    """
    first = {name: FirstEpisodes(name, () if name in finished else episodes) for name, episodes in waiting.items()}
    failed: set[str] = set()
    num_policies = sum(map(bool, waiting.values()))

    def blocks() -> Iterator[Any]:
        for name, episodes in waiting.items():
            for block in _blocks(episodes, setting.config.num_envs, engine, num_policies):
                if name not in failed:
                    bounds = {episode: lower_bound_steps[episode] for episode in block if episode in lower_bound_steps}
                    yield name, block, bounds, real_time and real_time.of(name, block)

    with closing(_batches(setting, actors, worlds, blocks(), engine)) as batches:
        for batch in batches:
            counted = _counted(batch, first[batch.policy])
            if counted.failure:
                if counted.policy in failed:
                    continue
                failed.add(counted.policy)
            lower_bound_steps.update((result.episode, result.lower_bound_steps) for result in counted.results)
            yield counted


def _batches(
    setting: Setting,
    actors: Mapping[str, Policy],
    worlds: WorldsByInterface,
    blocks: Iterator[Any],
    engine: Engine,
) -> Generator[RolloutBatch, None, None]:
    """Play `blocks`, which are arguments of `_play`, in workers."""
    if isinstance(engine, Cluster):
        sent, files = _for_sending(setting, actors, worlds)
        return engine.run(_play, sent, blocks, files)
    # The setting is sent with each block, with no other policy.
    single = {name: replace(setting, policies={name: policy}) for name, policy in setting.policies.items()}
    return engine.run(_call, _play, ((single[block[0]], *block) for block in blocks))


def _counted(batch: RolloutBatch, first: FirstEpisodes) -> RolloutBatch:
    """Return what counts of a batch, or that its policy cannot play."""
    results: list[EpisodeResult] = []
    try:
        for result in batch.results:
            results += first.counted(result)
    except PolicyFailed as failure:
        return failed(batch.policy, results, failure)
    return replace(batch, results=results)


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


def _blocks(episodes: Sequence[int], num_envs: int, engine: Engine, num_policies: int) -> Iterator[Sequence[int]]:
    """Return blocks that keep all workers busy with so many policies; of one episode if one world plays."""
    if num_envs == 1 and engine.groups_units:
        size = 1
    else:
        size = max(1, min(ROUNDS * num_envs, -(-len(episodes) // sharing(num_policies, engine.workers))))
    return (episodes[i : i + size] for i in range(0, len(episodes), size))


def _call(function: Callable[..., RolloutBatch], *arguments: Any) -> RolloutBatch:
    return function(*arguments)


def _play(
    setting: Setting,
    name: str,
    episodes: Sequence[int],
    lower_bound_steps: dict[int, float],
    real_time: RealTime | None,
) -> RolloutBatch:
    """Play a block of episodes in a worker, until the policy fails."""
    config = setting.config
    if os.getpid() != config.home:
        with contextlib.suppress(ValueError):  # threads of a cluster's worker get no signals
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the process that waits
    results: list[EpisodeResult] = []
    try:
        worlds, timed = _actor(setting, name)
        policy = RealTimePolicy(timed.policy, worlds, real_time, name) if real_time else timed
        policy.timeout = config.timeout
        if config.recording is not None:
            worlds = config.recording(worlds)
        results.extend(rollouts(policy, worlds, episodes, config.seed, name, lower_bound_steps))
        remarks = tuple(worlds.unwrapped.remarks)
    except (PolicyFailed, EnvironmentFailed) as failure:
        return failed(name, results, failure)
    return RolloutBatch(name, results, construction_ms=timed.construction_ms, remarks=remarks)


def failed(name: str, results: list[EpisodeResult], failure: PolicyFailed | EnvironmentFailed) -> RolloutBatch:
    """Return the results of a policy up to its failure, with the reason."""
    disqualified = isinstance(failure, PolicyDisqualified)
    return RolloutBatch(name, results, str(failure), format_cause(failure), disqualified)


_present: dict[tuple[WorkerConfig, str], tuple[WorldsByInterface, EpisodeVectorEnv, TimedPolicy]] = {}
"""The policies that play in this worker at present, each with its worlds: one, unless they play in turns."""


def _actor(setting: Setting, name: str) -> tuple[EpisodeVectorEnv, TimedPolicy]:
    """Return a policy in worlds of its own, in which no other one has begun an episode or written anything."""
    config, policy = setting.config, setting.policies[name]
    if (config, name) not in _present:
        for other in [other for other in _present if not (config.alternating and other[0] == config)]:
            _present.pop(other)[0].close()
        if config.maker is not None:  # another process has another script
            vars(sys.modules["__main__"]).setdefault(config.env.rpartition(":")[2], config.maker)
        interfaces = config.interfaces(config.env, config.num_envs, config.env_options, threads=1)
        worlds = interfaces.of(policy)
        actor, construction_ms = build_timed(policy, worlds, name, config.policy_seed, config.isolate, config.timeout)
        if expected := setting.identities.get(name):
            check_same_identity(expected, _identity_elsewhere(setting, name, actor, worlds))
        timed = TimedPolicy(actor, worlds.num_envs, config.workers)
        timed.construction_ms = construction_ms
        _present[config, name] = interfaces, worlds, timed
    return _present[config, name][1:]


def _for_sending(
    setting: Setting, actors: Mapping[str, Policy], worlds: WorldsByInterface
) -> tuple[Setting, list[Path]]:
    """Return the setting as another machine can use it, and the files that it names."""
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
    for code in filter(None, (actor.code for actor in actors.values() if isinstance(actor, PlaysApart))):
        files += [Path(file) for file in code.loaded if file.endswith(".py")]  # imported in the policy's process only
    sent = Setting(replace(config, env=relative(config.env), env_options=options), policies)
    identities = {
        name: _identity_elsewhere(sent, name, actor, worlds.of(setting.policies[name]))
        for name, actor in actors.items()
    }
    return replace(sent, identities=identities), files


def _file_named(name: str) -> list[Path]:
    """Return the file of `path/to/file.py:NAME` or `path/to/options.toml`, none of another name."""
    path = Path(name)
    if path.suffix != SUFFIX:
        path = Path(name.rpartition(":")[0])
    return [path] if path.suffix in (SUFFIX, ".py") else []


def _identity_elsewhere(setting: Setting, name: str, actor: Policy, worlds: EpisodeVectorEnv) -> dict[str, Any]:
    """Return what determines a policy's episodes, without what is sent: own code and objects."""
    config, policy = setting.config, setting.policies[name]
    complete = identity(config.env, config.env_options, config.seed, {name: policy}, {name: actor}, worlds)
    installed = isinstance(policy, str) and not is_code(policy) and ":" not in config.env
    sent = {"objects", "makers", LOADED} | (set() if installed else {"code", "registered", "constants"})
    return {key: value for key, value in complete.items() if key not in sent}
