"""Times the decisions of a policy, planning at the reset included, and says what the times are worth."""

from collections import Counter
from collections.abc import Iterable, Sequence
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from armctl.evaluation.episode_table import EpisodeTable, table_of
from armctl.evaluation.provenance import BUSY, Run
from armctl.evaluation.record import EpisodeResult
from armctl.policies import Actions, Policy
from armctl.tasks import Observations

DIGITS = 4
"""Of a decision time in ms: to 0.1 us."""


class TimedPolicy:
    """A policy in n worlds. The time of its reset belongs to the first decision of the episode.

    What a call takes is divided by the number of worlds that it is for. `cold` (n,) says in which worlds the first
    decision of the current episode was the policy's very first, in which code is loaded and compiled.
    """

    slow_down = 1.0
    """By how much a decision takes longer than it was measured."""

    def __init__(self, policy: Policy, n: int, workers: int = 1) -> None:
        self.policy = policy
        self.setting = (n, workers)
        """How many worlds share a call, and how many processes play."""
        self.cold = np.zeros(n, dtype=bool)
        self._fresh = True
        self._reset_ms = np.zeros(n)

    def reset(self, ids: NDArray[np.int32], episodes: Sequence[int]) -> None:
        """Worlds `ids` start these `episodes`."""
        self.cold[ids] = self._fresh
        start = perf_counter()
        self.policy.reset(ids)
        self._reset_ms[ids] = 1e3 * (perf_counter() - start) / len(ids)

    def act(self, observations: Observations) -> tuple[Actions, NDArray[np.float64]]:
        """Actions (n, ...), and the time of each world's decision, (n,) ms; NaN where none begins."""
        start = perf_counter()
        actions = self.policy.act(observations)
        spent = 1e3 * (perf_counter() - start) / len(self.cold) + self._reset_ms
        self._fresh = False
        self._reset_ms[:] = 0.0
        return actions, np.round(spent, DIGITS)


def comparable_times(results: Sequence[EpisodeResult]) -> EpisodeTable:
    """The results whose decision times were taken alike: the latencies, or else those of the most frequent setting."""
    table = table_of(results)
    played = table.column("worlds"), table.column("workers")
    settings = Counter(zip(*(one.tolist() for one in played), strict=True))
    best = max(settings, key=lambda setting: (setting == (1, 1), settings[setting]))
    alike: NDArray[np.bool_] = (played[0] == best[0]) & (played[1] == best[1])
    return table[alike]


def setting_in_words(worlds: int, workers: int) -> str:
    """What decision times are if they are not latencies; empty if they are."""
    said = [f"shares of a batch of {worlds} worlds"] if worlds > 1 else []
    others = "another worker" if workers == 2 else f"up to {workers - 1} other workers"
    said += [f"taken while {others} computed"] if workers > 1 else []
    return ", ".join(said)


def unjudged(results: EpisodeTable, runs: Iterable[Run]) -> EpisodeTable:
    """The results, without missed deadlines where other processes kept the machine busy."""
    busy = {run.id for run in runs if run.busy}
    told = zip(results.column("run").tolist(), results.column("missed_deadlines").tolist(), strict=True)
    return results.with_column("missed_deadlines", (None if run in busy else missed for run, missed in told))


def load_notes(results: EpisodeTable, runs: Iterable[Run]) -> list[str]:
    """A remark if decision times would be held against deadlines, had the machine been idle."""
    played = Counter(zip(*(results.column(name).tolist() for name in ("run", "worlds", "workers")), strict=True))
    latencies = {run for run, *setting in played if setting == [1, 1]}
    busy = {run.id for run in runs if run.busy and run.id in latencies}
    if not busy:
        return []
    count = sum(found for (run, *_), found in played.items() if run in busy)
    where = "" if count == len(results) else f" in {count} of {len(results)} episodes"
    return [
        f"Deadlines are not judged{where}: other processes kept more than {BUSY:.0%} of the processor's cores busy, so "
        "that decision times are longer than those of an idle machine."
    ]


def timing_notes(timed: Iterable[tuple[str, Sequence[EpisodeResult]]]) -> list[str]:
    """Remarks about the decision times of policies: what they are, and which episodes they leave out."""
    settings, notes = {}, []
    for policy, results in timed:
        alike = comparable_times(results)
        settings[policy] = setting_in_words(alike[0].worlds, alike[0].workers)
        if len(alike) < len(results):
            kind = settings[policy] or "latencies"
            counts = f"{len(alike)} of {len(results)} episodes"
            notes.append(
                f"Decision times of {policy} are from {counts}, and are {kind}: the others were played with other "
                "--worlds or --workers."
            )
    if len(kinds := set(settings.values())) > 1:
        said = "; ".join(f"those of {policy} are {words or 'latencies'}" for policy, words in settings.items())
        notes.append(f"Decision times cannot be compared: {said}.")
    elif kinds and (words := kinds.pop()):
        notes.append(f"Decision times are {words}. Only those of one world and one worker are held against deadlines.")
    return notes
