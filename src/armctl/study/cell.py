"""Plays a cell: every policy in the same episodes, each written as soon as it ends."""

from collections.abc import Callable, Collection, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.kinds import declared_kind
from armctl.core.registration import bare_id
from armctl.envs import EpisodeVectorEnv, ThirdPartyVectorEnv
from armctl.episodes.failures import PolicyDisqualified
from armctl.episodes.record import EpisodeResult
from armctl.episodes.store import CellWriter, Store
from armctl.episodes.stored import POLICY_SEED, UNDISTURBED
from armctl.episodes.table import EpisodeTable
from armctl.policies import Policy, WorldsByInterface
from armctl.policies.policy import PlaysApart
from armctl.rollout.construction import build_timed
from armctl.rollout.decision_times import TimedPolicy
from armctl.rollout.loop import environment_limit, wrap_environment_errors
from armctl.rollout.parallel import (
    RolloutBatch,
    Setting,
    WorkerConfig,
    check_sendable,
    failed,
    play_here,
    play_in_workers,
)
from armctl.rollout.real_time import RealTimePolicy, check_real_time
from armctl.rollout.seeding import check_seed
from armctl.runtime.identity import identity
from armctl.runtime.isolation import close
from armctl.runtime.provenance import RunMeter, machine, versions
from armctl.runtime.workers import WorkersFailed
from armctl.study.comparison import Comparison, concluded
from armctl.study.contenders import Task, contenders
from armctl.study.events import Events, check_return
from armctl.study.names import SUITE
from armctl.study.plan import Cell, Plan
from armctl.verdict.facts import Facts, PolicyFacts, training_cost_of
from armctl.verdict.sentences import is_decided

NOT_AN_ARMCTL_TASK = (
    "{env} is not made of a task of armctl's: its minimum times, feasibility, contacts and clearances are unknown."
)

NO_PAIRS = (
    "{env} does not obey its seed, so that episodes are no pairs, and no method holds at any number of them: leave out "
    "--until decided"
)
BlockPlayer = Callable[[Mapping[str, Sequence[int]], Collection[str]], Generator[RolloutBatch, None, None]]


class Recorder:
    """Keeps more of a study's episodes than their results. This one keeps nothing more."""

    interfaces: Callable[..., WorldsByInterface] = WorldsByInterface
    """Class of the worlds."""
    recording: Callable[[EpisodeVectorEnv], Any] | None = None
    """Wrapper of the worlds that records their episodes."""

    def check(self, env: EpisodeVectorEnv, cell: Cell) -> None:
        """Check what is to be recorded of a cell, before anything is written. Raises `ArmctlError`."""

    def open(self) -> None:
        """Prepare the folder, to which no other process writes by now. Raises `ResultsError`."""

    def lost(self, kept: EpisodeTable) -> NDArray[np.int64]:
        """Return the numbers of the `kept` episodes that have to be played again. Raises `ResultsError`."""
        return np.empty(0, np.int64)

    def keep(self, result: EpisodeResult) -> bool:
        """Keep what is recorded of an episode; return whether its result counts. Raises `ResultsError`."""
        return True

    def finish(self, comparison: Comparison) -> None:
        """Write what was kept, after the last episode. Raises `ResultsError`."""


@dataclass(frozen=True)
class Session:
    """Values that all cells of a study share while they are played."""

    plan: Plan
    store: Store
    policy_seed: int
    on_first_cell: Callable[[], None]
    """Called when a cell can be written to the store."""
    progress: Callable[[Cell, EpisodeResult], None]
    """Called with every finished episode, and first with those of an earlier run."""
    recorder: Recorder


@dataclass(frozen=True)
class _Line:
    """Policies of a cell, as built in this process, and their worlds."""

    cell: Cell
    plan: Plan
    policy_seed: int
    recorder: Recorder
    interfaces: WorldsByInterface
    policies: Mapping[str, Policy]

    @property
    def playing(self) -> dict[str, Any]:
        """The policies as they were asked for, by name, without those that cannot play."""
        return {name: policy for name, policy in self.cell.players.items() if name in self.policies}

    @property
    def env(self) -> EpisodeVectorEnv:
        """The worlds as they were asked for."""
        return self.interfaces.requested

    def identity(self) -> dict[str, Any]:
        """Return everything that determines the episodes."""
        cell = self.cell
        real_time = None if cell.real_time is None else cell.real_time.identity(cell.players)
        about = identity(cell.env, cell.env_options, self.plan.seed, cell.players, self.policies, self.env, real_time)
        return {**about, POLICY_SEED: str(self.policy_seed)}

    def play(self, kept: EpisodeTable, task: Task, first: int, counts: Sequence[int]) -> Iterator[RolloutBatch | int]:
        """Play the episodes from the `first` on that were not `kept`, in blocks; yield their number after each."""
        finished = {name: episodes.column("episode") for name, episodes in kept.by_policy().items()}
        lengths = (kept.column(name).tolist() for name in ("episode", "lower_bound_steps"))
        task.lower_bound_steps.update(zip(*lengths, strict=True))
        play_block, playing, start = self._block_player(task.lower_bound_steps), set(finished), 0
        names = [*self.policies]
        for end in counts:
            names.sort(key=task.spent.__getitem__, reverse=True)  # the longest first: workers end together
            numbers = {name: np.arange(first + start, first + min(end, task.enough(self.cell, name))) for name in names}
            waiting = {name: np.setdiff1d(numbers[name], finished.get(name, [])).tolist() for name in names}
            with closing(play_block(waiting, playing)) as batches:
                for batch in batches:
                    yield batch
                    task.spent[batch.policy] += sum(np.nansum(result.decision_ms) for result in batch.results)
                    names = [name for name in names if name != batch.policy or not batch.failure]
            start, playing = end, playing | set(names)
            yield end

    def _block_player(self, lower_bound_steps: dict[int, float]) -> BlockPlayer:
        """Return a function that plays episodes by policy; it takes also the names of policies that have played."""
        cell, plan, engine = self.cell, self.plan, self.plan.engine
        interfaces, recording = self.recorder.interfaces, self.recorder.recording
        if engine.is_local:
            worlds = {name: self.interfaces.of(policy) for name, policy in self.playing.items()}
            if recording is not None:
                worlds = {name: recording(vec_env) for name, vec_env in worlds.items()}
            timed = {
                name: RealTimePolicy(policy, worlds[name], cell.real_time, name)
                if cell.real_time
                else TimedPolicy(policy, worlds[name].num_envs)
                for name, policy in self.policies.items()
            }
            for policy in timed.values():
                policy.timeout = plan.timeout
            return lambda waiting, finished: play_here(timed, worlds, plan.seed, waiting, lower_bound_steps, finished)
        close(self.policies.values())  # workers make their own
        config = WorkerConfig(
            cell.env, plan.num_envs_in(cell), dict(cell.env_options), plan.seed, self.policy_seed, engine.workers,
            plan.isolate, plan.timeout, interfaces=interfaces, recording=recording, alternating=plan.until_decided,
        )  # fmt: skip
        setting = Setting(config, self.playing)
        return lambda waiting, finished: play_in_workers(
            setting, self.policies, self.interfaces, waiting, lower_bound_steps, engine, cell.real_time, finished
        )

    def facts(self, events: Events, notes: list[str], resumed: int, first: int) -> Facts:
        """Return everything that is stored besides the episodes and runs."""
        cell, plan, env = self.cell, self.plan, self.env
        real_time, at_most = cell.real_time, plan.episodes_in(cell) - first
        return Facts(
            env_options={name: str(value) for name, value in cell.env_options.items()},
            policy_seed=self.policy_seed,
            planned=events.decided_after or at_most,
            first_episode=first,
            at_most=at_most if plan.until_decided else None,
            policies={
                name: PolicyFacts(
                    self.interfaces.privilege(self.playing[name], policy),
                    training_cost_of(policy),
                    events.construction_ms[name],
                    tuple(self.interfaces.spared(self.playing[name], policy)),
                    getattr(policy, "family", None),
                    tuple(name for name in getattr(policy, "foresight", ()) if name in env.foresight),
                    declared_kind(policy),
                    interface=self.interfaces.in_words(self.playing[name]),
                    isolated=isinstance(policy, PlaysApart),
                    transport_ms=getattr(policy, "transport_ms", None),
                )
                for name, policy in self.policies.items()
            },
            return_bounds=env.return_bounds,
            time_limit=env.max_episode_steps,
            control_period=env.task.control_period,
            versions=versions(),
            machine=machine(),
            notes=[*dict.fromkeys([*notes, *env.remarks, *events.remarks])],
            failures=events.failures,
            baseline=plan.baseline,
            margin=plan.margin,
            real_time=None if real_time is None else {"latency": real_time.latency, "slow_down": real_time.slow_down},
            groups=cell.groups,
            disqualified=events.disqualified,
            interrupted=events.interrupted,
            resumed=resumed,
        )


def play_cell(cell: Cell, session: Session, task: Task) -> Comparison:
    """Play the episodes of a cell with all its policies, except those that its store has.

    All checks come before the first write to the store.

    Raises `ConfigurationError`, `AgentFileError`, and `ResultsError` as `Store` does. What goes wrong later is in the
    result's failures.
    """
    plan, store, recorder = session.plan, session.store, session.recorder
    with ExitStack() as stack:
        num_envs = plan.num_envs_in(cell)
        interfaces = recorder.interfaces(cell.env, num_envs if plan.engine.is_local else 1, cell.env_options)
        stack.callback(interfaces.close)
        events = Events()
        policies = _policies(cell, interfaces, session, events)
        stack.callback(close, policies.values())
        line = _Line(cell, plan, session.policy_seed, recorder, interfaces, policies)
        notes = _notes(line, task)
        if not task.obeys_seed:
            line = replace(line, plan=replace(plan, until_decided=False))
        recorder.check(line.env, cell)
        store.open(plan.seed, [other.name for other in plan.cells])
        recorder.open()
        about = line.identity() if store.folder else {"env": cell.env, "seed": plan.seed, "policies": [*cell.players]}
        meter = RunMeter(about, num_envs, plan.engine.workers)
        writer = store.cell(cell.name, about, plan.episodes_in(cell), meter.run)
        session.on_first_cell()
        writer.forget(recorder.lost(writer.kept))
        for result in writer.kept:
            session.progress(cell, result)
        first = task.first_episode(cell, plan.episodes_in(cell))

        def decided(count: int) -> bool:
            results = _results(writer, line, events)
            facts = line.facts(events, notes, len(writer.kept), first)
            results = results[results.column("episode") < first + count]
            if plan.kind != SUITE:
                return is_decided(results, facts, plan.num_verdicts_with(cell))
            so_far = Comparison(writer.identity, cell.env_options, facts, results, writer.runs)
            return task.is_decided(cell, so_far, plan.num_verdicts_with(cell))

        _play(line, writer, task, first, meter, events, session, decided)
        results = _results(writer, line, events)
        events.note_crashes(results)
        counts = ((name, len(episodes)) for name, episodes in results.by_policy().items())
        judged = min((count for name, count in counts if count < task.enough(cell, name)), default=0)
        runs = [*writer.runs, meter.finished(judged, plan.baseline, plan.margin)]
        facts = replace(line.facts(events, notes, len(writer.kept), first), paired=task.obeys_seed)
        try:
            runs = writer.finish(asdict(facts), runs, events.disqualified)
        except ResultsError as error:
            facts.failures["results"] = str(error)
        comparison = concluded(writer.identity, cell.env_options, facts, results, runs, events.tracebacks)
        if plan.kind == SUITE and line.plan.until_decided and cell.setting == UNDISTURBED:
            task.contenders = contenders(comparison, any_number=True)
        recorder.finish(comparison)
        return comparison


def _results(writer: CellWriter, line: _Line, events: Events) -> EpisodeTable:
    """Return the episodes of all policies that are not disqualified, sorted."""
    results = writer.episodes()
    return results[~np.isin(results.column("policy"), events.disqualified)].sorted(list(line.policies))


def _policies(cell: Cell, interfaces: WorldsByInterface, session: Session, events: Events) -> dict[str, Policy]:
    """Return the policies, built before anything is reset; without any that write to the world."""
    policies = dict[str, Policy]()
    for name, policy in cell.players.items():
        try:
            policies[name], events.construction_ms[name] = build_timed(
                policy, interfaces.of(policy), name, session.policy_seed, session.plan.isolate, session.plan.timeout
            )
        except PolicyDisqualified as failure:
            events.note(failed(name, [], failure))
    return policies


def _notes(line: _Line, task: Task) -> list[str]:
    """Return remarks about an environment, before anything is played in it. Raise `ConfigurationError`."""
    cell, env = line.cell, line.env
    with wrap_environment_errors("a trial", 0, environment_limit(env, line.plan.timeout)):
        env.reset(seed=line.plan.seed)  # raises for an invalid seed
    notes = cell.single_trainings
    if cell.real_time is not None:
        check_real_time(bare_id(cell.env), env)
        notes.append(cell.real_time.in_words(env.task.control_period))
    if not line.plan.engine.is_local:
        check_sendable(line.playing)
    task.seeding = task.seeding or check_seed(cell.env, cell.env_options, line.plan.timeout)
    if line.plan.until_decided and line.plan.kind != SUITE and not task.obeys_seed:
        raise ConfigurationError(NO_PAIRS.format(env=bare_id(cell.env)))
    notes += task.seeding.notes
    if isinstance(env, ThirdPartyVectorEnv):
        notes += filter(None, (NOT_AN_ARMCTL_TASK.format(env=bare_id(cell.env)), env.success.in_words))
    return notes


def _play(
    line: _Line,
    writer: CellWriter,
    task: Task,
    first: int,
    meter: RunMeter,
    events: Events,
    session: Session,
    decided: Callable[[int], bool],
) -> None:
    """Write episodes until all are played or it is decided, the workers are lost, or somebody interrupts."""
    in_workers = dict[str, float]()
    kept = max(0, int(writer.kept.column("episode").max(initial=-1)) + 1 - first)
    counts = line.plan.block_ends(line.cell, kept, [run.judged for run in writer.runs if run.judged], first)
    if kept and line.plan.kind == SUITE:
        decided(kept)  # who represents a kind, and plays on
    try:
        with closing(line.play(writer.kept, task, first, counts)) as stream:  # type: ignore[type-var]
            for batch in stream:
                if isinstance(batch, int):
                    if batch < counts[-1] and decided(batch):
                        events.decided_after = batch
                        break
                    continue
                events.note(batch)
                if (spent := batch.construction_ms) is not None:
                    in_workers[batch.policy] = max(spent, in_workers.get(batch.policy, 0.0))
                meter.update_load()
                for result in batch.results:
                    check_return(result, line.env.stated_return_bounds)
                    if session.recorder.keep(result):
                        writer.write(replace(result, run=meter.run.id))
                        session.progress(line.cell, result)
    except WorkersFailed as failure:
        events.failures["workers"] = str(failure)
    except KeyboardInterrupt:
        events.interrupted = True
    events.construction_ms |= in_workers
