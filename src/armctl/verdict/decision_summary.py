"""Summarises the decision times of a policy's episodes."""

import math
from dataclasses import dataclass

import numpy as np

from armctl.core.arrays import Array
from armctl.episodes.table import EpisodeTable
from armctl.stats.intervals import Estimate


@dataclass(frozen=True, kw_only=True)
class DecisionTimes:
    """Times of decisions, in the episodes that were played with `worlds` and `workers`.

    Decisions are warm, all but the policy's first in its process, unless a field says otherwise.
    """

    decision_ms_p50: float
    decision_ms_p99: float
    decision_ms_max: float
    missed_deadlines: float | None
    """Share of decisions whose time exceeded the control period; None if that is unknown (see `timing`)."""
    first_call_ms: float | None = None
    """The longest first decision of the policy in a process; None if that was in none of the episodes."""
    worlds: int = 1
    """Number of worlds that shared the policy's calls."""
    workers: int = 1
    """Number of processes that played at a time."""
    decision_seconds: Estimate | None = None
    """Mean over episodes of the time of the reset and all decisions, the first one included."""
    reset_ms: float | None = None
    """Median over episodes; None if unknown."""
    first_decision_ms: float | None = None
    """Median over episodes of the reset with the first decision, in which planners plan; None if none was warm."""
    control_step_ms: float = math.nan
    """Median over warm episodes of the time of the reset and all decisions, for each control step; else the median.

    Unlike the median decision, it has all planning, whenever that is done; unlike the mean, it does not follow the few
    decisions that other processes interrupt."""
    construction_ms: float | None = None
    """Time to make the policy in the process that played, of several the longest; divided by the number of
    controllers, if there is one for each world. None if unknown."""


def decision_times(timed: EpisodeTable, construction_ms: float | None, by_episode: bool) -> DecisionTimes:
    """Return the decision times of a policy; of those that are known `by_episode`, not by decision, the median."""
    decisions = timed.warm_times()
    if by_episode:
        p50 = decisions.median
        return DecisionTimes(
            decision_ms_p50=p50,
            decision_ms_p99=math.nan,
            decision_ms_max=math.nan,
            missed_deadlines=None,
            control_step_ms=p50,
        )
    resets, first_calls = _finite(timed.column("reset_ms")), _finite(timed.column("first_call_ms"))
    first_decisions, seconds, is_warm = timed.first_decision_ms(), timed.decision_seconds(), timed.is_warm
    per_step = 1e3 * seconds[is_warm] / timed.column("length")[is_warm]
    p50, p99, longest = decisions.quantiles((0.5, 0.99, 1.0))
    missed = timed.counts("missed_deadlines")
    return DecisionTimes(
        decision_ms_p50=p50,
        decision_ms_p99=p99,
        decision_ms_max=longest,
        missed_deadlines=None
        if (None,) in missed
        else sum(misses * count for (misses,), count in missed.items()) / max(len(decisions), 1),
        first_call_ms=float(first_calls.max()) if len(first_calls) else None,
        worlds=timed[0].worlds,
        workers=timed[0].workers,
        decision_seconds=Estimate(float(seconds.mean()), None, None),
        reset_ms=float(np.median(resets)) if len(resets) else None,
        first_decision_ms=float(np.median(first_decisions)) if len(first_decisions) else None,
        control_step_ms=float(np.median(per_step)) if len(per_step) else p50,
        construction_ms=construction_ms,
    )


def _finite(values: Array) -> Array:
    return values[~np.isnan(values)]
