"""Summarises a comparison's episodes, for each policy and each pair of policies."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.envs import SEES
from armctl.envs.vector import UNSTABLE
from armctl.evaluation.record import EpisodeResult
from armctl.evaluation.statistics import (
    Estimate,
    PairedDifference,
    interquartile_mean,
    mean,
    median,
    paired_difference,
    success_rate,
)
from armctl.policies import Policy

METRICS = (
    "path_length", "smoothness", "range_use", "speed_use", "torque_use", "energy", "clearance", "contacts",
)  # fmt: skip
"""The fields of `armctl.evaluation.metrics.Metrics` whose means are in the summary."""


@dataclass(frozen=True)
class PolicySummary:
    """One policy over all its episodes."""

    policy: str
    sees: str
    training_steps: int
    training_minutes: float
    planned: int
    """Number of episodes asked for."""
    episodes: int
    """Number of episodes that count: feasible ones, up to the first that was not finished."""
    infeasible: int
    """Number of infeasible episodes, which no policy won: they are left out of all figures."""
    outcomes: dict[str, int]
    """How the episodes ended, most frequent first."""
    success: Estimate | None
    """None if the environment does not say what a success is."""
    episode_return: Estimate | None
    return_iqm: Estimate | None
    """Interquartile mean of the return (Agarwal et al. 2021), which is robust to outliers."""
    steps_to_goal: Estimate | None
    """Mean over successful episodes."""
    optimality_gap: Estimate | None
    """Median relative excess of successful episodes' lengths over the least possible, where that is known."""
    tracking_error: Estimate | None
    """m, mean distance to a moving target after it was first reached."""
    metrics: dict[str, Estimate | None]
    """Means of `METRICS` over successful episodes, or over all if success is unknown."""
    decision_ms_p50: float
    decision_ms_p99: float
    decision_ms_max: float
    missed_deadlines: float | None
    """Share of control steps whose decision time exceeded the control period; None if that is unknown."""
    solver_failures: int
    """Number of control steps in which the controller's solver failed, if it counts them."""
    length: Estimate | None = None
    """Mean number of control steps, over all episodes; None in results of older versions."""

    @property
    def knowledge(self) -> tuple[str, str]:
        """What it sees, as tables say it: on two lines, of which the second may be empty."""
        first, plus, more = SEES.get(self.sees, self.sees).partition(" + ")
        return first, plus.lstrip() + more

    @property
    def unstable(self) -> int:
        """Number of episodes whose physics failed: infinite numbers, or none. They are no successes."""
        return self.outcomes.get(UNSTABLE, 0)


def summarise(
    results: Sequence[EpisodeResult], policies: Mapping[str, Policy], planned: int
) -> tuple[list[PolicySummary], list[PairedDifference]]:
    """Summaries of policies and of pairs. `results` are sorted by policy and episode."""
    counted, infeasible = counted_results(results)
    scored = any(result.success is not None for result in results)
    found = [
        _summary(name, policy, planned, infeasible, counted[name], scored)
        for name, policy in policies.items()
        if counted.get(name)
    ]
    return found, _paired(counted, scored)


def counted_results(results: Sequence[EpisodeResult]) -> tuple[dict[str, list[EpisodeResult]], int]:
    """The results that count, by policy and episode, and the number of infeasible episodes, which do not.

    Of a policy that was cut short, only the episodes before the first unfinished one count: with many worlds, short
    episodes end first, so that all finished ones would be a biased sample.
    """
    won = {result.episode for result in results if result.success}
    infeasible = {result.episode for result in results if not result.feasible} - won
    counted = {}
    for name, played in itertools.groupby(results, key=lambda result: result.policy):
        unbroken = itertools.takewhile(lambda pair: pair[0] == pair[1].episode, enumerate(played))
        counted[name] = [result for _, result in unbroken if result.episode not in infeasible]
    return counted, len(infeasible)


def _summary(
    name: str, policy: Policy, planned: int, infeasible: int, results: list[EpisodeResult], scored: bool
) -> PolicySummary:
    decisions = np.concatenate([result.decision_ms for result in results])
    won = [result for result in results if result.success]
    missed = [result.metrics.missed_deadlines for result in results]
    returns = np.array([result.total_reward for result in results])
    return PolicySummary(
        name,
        policy.sees,
        policy.training_steps,
        getattr(policy, "training_minutes", None) or 0.0,
        planned,
        len(results),
        infeasible,
        dict(Counter(result.outcome for result in results).most_common()),
        success_rate(np.array([bool(result.success) for result in results])) if scored else None,
        mean(returns),
        interquartile_mean([returns]),
        mean(np.array([float(result.length) for result in won])),
        median(_known(result.optimality_gap for result in results)),
        mean(_known(result.tracking_error for result in results)),
        {name: _mean_metric(name, won if scored else results) for name in METRICS},
        float(np.quantile(decisions, 0.5)),
        float(np.quantile(decisions, 0.99)),
        float(decisions.max()),
        None if None in missed else sum(one for one in missed if one) / len(decisions),
        sum(result.metrics.solver_failures for result in results),
        mean(np.array([float(result.length) for result in results])),
    )


def _mean_metric(name: str, results: Sequence[EpisodeResult]) -> Estimate | None:
    values = [getattr(result.metrics, name) for result in results]
    return mean(_known(float(value) for value in values if value is not None))


def _known(values: Iterable[float]) -> NDArray[np.float64]:
    return np.array([value for value in values if not np.isnan(value)])


def _paired(counted: dict[str, list[EpisodeResult]], scored: bool) -> list[PairedDifference]:
    return [
        paired_difference(
            a,
            b,
            _both(counted[a], counted[b], lambda result: bool(result.success)) if scored else None,
            _both(counted[a], counted[b], lambda result: result.total_reward),
            _both(counted[a], counted[b], lambda result: float(result.length)),
        )
        for a, b in itertools.combinations(counted, 2)
        if counted[a] and counted[b]
    ]


def _both(
    a: list[EpisodeResult], b: list[EpisodeResult], value: Callable[[EpisodeResult], float]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """A value of the episodes that both played, which are the first ones, since neither has gaps."""
    pairs = list(zip(a, b, strict=False))
    return np.array([value(first) for first, _ in pairs]), np.array([value(second) for _, second in pairs])
