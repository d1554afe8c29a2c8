"""Times of the construction, the resets and the decisions of a policy, and remarks on what they are worth."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Observations
from armctl.episodes.table import EpisodeTable
from armctl.policies import Actions, ControllersFailed, PerWorld, Policy
from armctl.runtime.provenance import MAX_BACKGROUND_LOAD, Run

Errors = dict[int, BaseException]
"""Errors of a policy, by the world in which each arose."""
DIGITS = 4
"""Decimals of a time in ms: to 0.1 us."""


class TimedPolicy:
    """A policy in n worlds.

    The time of a call is divided by the number of worlds in which it decides. `first_call` (n,) marks the worlds in
    which the first decision of the current episode was the policy's very first, in which code is loaded and compiled.
    """

    slow_down = 1.0
    """Factor by which a decision takes longer than it was measured."""
    timeout: float | None = None
    """Time (s) that a call of the policy, or of its environment, may take; None: any."""

    def __init__(self, policy: Policy, n: int, workers: int = 1) -> None:
        self.policy = policy
        self.setting = (n, workers)
        """Numbers of worlds that share a call, and of processes that play."""
        self.first_call = np.zeros(n, dtype=bool)
        self.construction_ms: float | None = None
        """Time to make it, if that was measured."""
        self.reset_ms = np.zeros(n)
        """(n,) the time of the reset with which each world's current episode began."""
        self._fresh = True

    def reset(self, ids: NDArray[np.int32], episodes: Sequence[int]) -> Errors:
        """Start these `episodes` in the worlds `ids`."""
        self.first_call[ids] = self._fresh
        start, errors = perf_counter(), Errors()
        try:
            self.policy.reset(ids)
        except ControllersFailed as failure:
            errors = failure.errors
        self.reset_ms[ids] = np.round(1e3 * self._seconds_since(start) / len(ids), DIGITS)
        return errors

    def act(self, observations: Observations) -> tuple[Actions, NDArray[np.float64], Errors]:
        """Return actions (n, ...), and the time of each world's decision, (n,) ms; NaN where none begins."""
        start, errors = perf_counter(), Errors()
        try:
            actions: Any = self.policy.act(observations)
        except ControllersFailed as failure:
            actions, errors = failure.actions, failure.errors
        n = len(self.first_call)
        num_acting = self.policy.num_acting if isinstance(self.policy, PerWorld) else n
        spent = np.full(n, 1e3 * self._seconds_since(start) / num_acting)
        self._fresh = False
        return actions, np.round(spent, DIGITS), errors

    def idle(self, ids: NDArray[np.integer[Any]]) -> None:
        """Let controllers rest whose episodes, in the worlds `ids`, are over; a policy of all worlds acts in all."""
        if isinstance(self.policy, PerWorld):
            self.policy.idle(ids)

    def _seconds_since(self, start: float) -> float:
        """Return the duration of a call; of an isolated policy, as measured around it in the policy's own process."""
        return float(getattr(self.policy, "seconds", perf_counter() - start))


def timed_construction(make: Callable[[], Policy]) -> tuple[Policy, float]:
    """Make a policy. Return also the time that took, ms: of a controller, if there is one for each world."""
    start = perf_counter()
    policy = make()
    spent = 1e3 * (perf_counter() - start)
    return policy, round(spent / len(getattr(policy, "controllers", [policy])), DIGITS)


@dataclass(frozen=True)
class Machines:
    """Machines on which the episodes of each run were played. Times of different machines are not pooled."""

    by_run: Mapping[str, str]
    busiest: str = ""
    """The machine with the most episodes."""

    @classmethod
    def of(cls, runs: Iterable[Run], results: EpisodeTable) -> "Machines":
        """Return the machines of these results, by their runs. Machines of one processor and as many cores are one."""
        by_run = {run.id: f"{run.processor}, {run.cores} cores" for run in runs}
        counts = Counter[str]()
        for (run,), count in results.counts("run").items():
            counts[by_run.get(run, "")] += count
        return cls(by_run, counts.most_common(1)[0][0] if counts else "")

    def settings(self, results: EpisodeTable) -> tuple[list[tuple[int, int, str]], NDArray[np.intp]]:
        """Return settings, and which each episode has: worlds, workers and machine, empty if it is unknown.

        Several runs on one machine have the same setting.
        """
        values, codes = results.different("worlds", "workers", "run")
        return [(num_envs, workers, self.by_run.get(run, "")) for num_envs, workers, run in values], codes


def comparable_times(results: EpisodeTable, machines: Machines = Machines({})) -> EpisodeTable:
    """Return the results whose times were taken alike: of one number of worlds and workers, and on one machine.

    They are latencies if there are any, of the machine with the most episodes if there are any, or else the most.
    """
    settings, codes = machines.settings(results)
    counts = Counter[tuple[int, int, str]]()
    for setting, count in zip(settings, np.bincount(codes).tolist(), strict=True):
        counts[setting] += count
    best = max(counts, key=lambda setting: (setting[:2] == (1, 1), setting[2] == machines.busiest, counts[setting]))
    return results[np.array([setting == best for setting in settings])[codes]]


def setting_in_words(num_envs: int, workers: int) -> str:
    """Return the kind of decision times if they are not latencies; empty if they are."""
    parts = [f"shares of a batch of {num_envs} worlds"] if num_envs > 1 else []
    others = "another worker" if workers == 2 else f"up to {workers - 1} other workers"
    parts += [f"taken while {others} computed"] if workers > 1 else []
    return ", ".join(parts)


def without_deadline_verdicts(results: EpisodeTable, runs: Iterable[Run]) -> EpisodeTable:
    """Return the results, without missed deadlines where other processes kept the machine busy."""
    busy = {run.id for run in runs if run.busy}
    values, codes = results.different("run")
    return results.without("missed_deadlines", np.array([run in busy for (run,) in values])[codes])


def load_notes(results: EpisodeTable, runs: Iterable[Run]) -> list[str]:
    """Return a remark if decision times are not held against deadlines because the machine was busy."""
    counts = results.counts("run", "worlds", "workers")
    latencies = {run for run, *setting in counts if setting == [1, 1]}
    busy = {run.id for run in runs if run.busy and run.id in latencies}
    if not busy:
        return []
    count = sum(episodes for (run, *_), episodes in counts.items() if run in busy)
    where = "" if count == len(results) else f" in {count} of {len(results)} episodes"
    return [
        f"Deadlines are not judged{where}: other processes kept more than {MAX_BACKGROUND_LOAD:.0%} of the processor's "
        "cores busy, so that decision times are longer than those of an idle machine."
    ]


def timing_notes(timed: Iterable[tuple[str, EpisodeTable]], machines: Machines = Machines({})) -> list[str]:
    """Return remarks about the decision times of policies: their kind, and the episodes that they leave out."""
    kinds, notes = {}, []
    for policy, table in timed:
        comparable = comparable_times(table, machines)
        settings = set(machines.settings(table)[0])
        (setting,) = set(machines.settings(comparable)[0])
        kinds[policy] = setting_in_words(*setting[:2]), setting[2]
        if len(comparable) < len(table):
            others = ["with other --worlds or --workers"] if any(other[:2] != setting[:2] for other in settings) else []
            elsewhere = sorted({other[2] or "an unknown machine" for other in settings} - {setting[2]})
            others += (
                [f"on {' and '.join(elsewhere)}, not on {setting[2] or 'an unknown machine'}"] if elsewhere else []
            )
            notes.append(
                f"Decision times of {policy} are from {len(comparable)} of {len(table)} episodes, and are "
                f"{kinds[policy][0] or 'latencies'}: the others were played {', or '.join(others)}."
            )
    if len(set(kinds.values())) > 1:
        where = {policy: f" on {place or 'an unknown machine'}" for policy, (_, place) in kinds.items()}
        where = where if len({place for _, place in kinds.values()}) > 1 else {}
        parts = (f"those of {name} are {kind or 'latencies'}{where.get(name, '')}" for name, (kind, _) in kinds.items())
        notes.append(f"Decision times cannot be compared: {'; '.join(parts)}.")
    elif kinds and (words := next(iter(kinds.values()))[0]):
        notes.append(f"Decision times are {words}. Only those of one world and one worker are held against deadlines.")
    return notes
