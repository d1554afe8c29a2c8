"""Summarises a comparison's episodes, for each policy and each pair of policies."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.agents import TrainingCost
from armctl.envs import SEES
from armctl.envs.vector import UNSTABLE
from armctl.evaluation.decision_times import comparable_times, setting_in_words
from armctl.evaluation.paired import PairedDifference, paired_difference
from armctl.evaluation.record import EpisodeResult
from armctl.evaluation.statistics import Bounds, Estimate, bounded_mean, mean, median, success_rate, worst_decile
from armctl.policies import Policy

WITHIN_RANGE, WITHIN_SPEED = 1.01, 1.2
"""Largest use of a joint's range, and of its speed limit, in a clean episode: servos overshoot a little."""
METRICS = (
    "path_length", "smoothness", "range_use", "speed_use", "torque_use", "energy", "clearance", "contacts",
)  # fmt: skip
"""The fields of `armctl.evaluation.metrics.Metrics` whose means are in the summary."""


@dataclass(frozen=True)
class PolicySummary:
    """One policy over all its episodes."""

    policy: str
    sees: str
    training: TrainingCost
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
    steps_to_goal: Estimate | None
    """Mean over successful episodes, which flatters whoever wins only the easy ones: see `restricted_steps`."""
    optimality_gap: Estimate | None
    """Median relative excess of successful episodes' lengths over the least possible, where that is known."""
    tracking_error: Estimate | None
    """m, mean distance to a moving target after it was first reached."""
    metrics: dict[str, Estimate | None]
    """Means of `METRICS` over successful episodes, or over all if success is unknown."""
    decision_ms_p50: float
    """Of warm decisions, like the next two, in the episodes that `worlds` and `workers` tell."""
    decision_ms_p99: float
    decision_ms_max: float
    missed_deadlines: float | None
    """Share of warm decisions whose time exceeded the control period; None if that is unknown (see `timing`)."""
    solver_failures: int
    """Number of control steps in which the controller's solver failed, if it counts them."""
    length: Estimate | None = None
    """Mean number of control steps, over all episodes; None in results of older versions."""
    clean_success: Estimate | None = None
    """Rate of `clean` successes; None if contacts are unknown."""
    worst_decile: Estimate | None = None
    """Mean of the worst tenth of the returns: the conditional value at risk."""
    restricted_steps: Estimate | None = None
    """Mean steps to the goal over all episodes, a failure counting as the time limit; None without a limit."""
    efficiency: Estimate | None = None
    """Mean of success times least possible length over length (SPL, Anderson et al. 2018, arXiv:1807.06757)."""
    decision_ms_cold: float | None = None
    """The longest first decision of the policy in a process; None if that was in none of the episodes."""
    worlds: int = 1
    """How many worlds shared the policy's calls in the episodes from which the decision times are."""
    workers: int = 1
    """How many processes played at a time in these."""
    decision_ms_mean: float | None = None
    """Of warm decisions, like the median; None in results of older versions, like the next one."""
    decision_seconds: Estimate | None = None
    """Mean over episodes of the time of all their decisions, the cold one included."""

    @property
    def learned(self) -> bool:
        """Whether it was trained."""
        return self.training.steps > 0

    @property
    def decision_ms(self) -> float:
        """Mean time of a warm decision, or the median in results of older versions."""
        return self.decision_ms_p50 if self.decision_ms_mean is None else self.decision_ms_mean

    @property
    def timing(self) -> str:
        """What the decision times are, in words; empty for latencies, by which deadlines can be judged."""
        return setting_in_words(self.worlds, self.workers)

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
    results: Sequence[EpisodeResult],
    policies: Mapping[str, Policy],
    planned: int,
    return_bounds: Bounds | None = None,
    time_limit: int | None = None,
) -> tuple[list[PolicySummary], list[PairedDifference]]:
    """Summaries of policies and of pairs. `results` are sorted by policy and episode.

    `return_bounds` are the least and largest possible return; if they are unknown, those of all results take their
    place. `time_limit` is the largest number of control steps of an episode.
    """
    counted, infeasible = counted_results(results)
    scored = any(result.success is not None for result in results)
    returns = [result.total_reward for result in results]
    limits = Limits(return_bounds or (min(returns), max(returns)), time_limit)
    found = [
        _summary(name, policy, planned, infeasible, counted[name], scored, limits)
        for name, policy in policies.items()
        if counted.get(name)
    ]
    return found, _paired(counted, scored, limits)


@dataclass(frozen=True)
class Limits:
    """Between which numbers returns and times lie."""

    returns: Bounds
    steps: int | None

    def restricted(self, results: Iterable[EpisodeResult]) -> NDArray[np.float64] | None:
        """Steps to the goal (k,), failures counting as the time limit; None without a limit."""
        if self.steps is None:
            return None
        return np.array([float(result.length if result.success else self.steps) for result in results])


def clean(result: EpisodeResult) -> bool | None:
    """Whether an episode was won without a forbidden contact, and within the joints' ranges and speed limits.

    `WITHIN_RANGE` and `WITHIN_SPEED` allow for what servos overshoot. None if contacts are unknown.
    """
    use = result.metrics
    if use.contacts is None:
        return None
    beyond = use.range_use > WITHIN_RANGE or use.speed_use > WITHIN_SPEED
    return bool(result.success) and not use.contacts and not beyond


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
    name: str, policy: Policy, planned: int, infeasible: int, results: list[EpisodeResult], scored: bool, limits: Limits
) -> PolicySummary:
    timed = comparable_times(results)
    decisions = np.concatenate([result.warm_ms for result in timed])
    cold = _known(result.metrics.decision_ms_cold for result in timed)
    won = [result for result in results if result.success]
    missed = [result.metrics.missed_deadlines for result in timed]
    returns = np.array([result.total_reward for result in results])
    cleanly = [clean(result) for result in results]
    restricted = limits.restricted(results) if scored else None
    lengths = np.array([float(result.length) for result in results])
    least = np.array([result.least_length for result in results])
    efficiency = np.array([bool(result.success) for result in results]) * least / np.maximum(lengths, least)
    return PolicySummary(
        name,
        policy.sees,
        _training_cost(policy),
        planned,
        len(results),
        infeasible,
        dict(Counter(result.outcome for result in results).most_common()),
        success_rate(np.array([bool(result.success) for result in results])) if scored else None,
        bounded_mean(returns, limits.returns),
        mean(np.array([float(result.length) for result in won])),
        median(_known(result.optimality_gap for result in results)),
        mean(_known(result.tracking_error for result in results)),
        {name: _mean_metric(name, won if scored else results) for name in METRICS},
        float(np.quantile(decisions, 0.5)),
        float(np.quantile(decisions, 0.99)),
        float(decisions.max()),
        None if None in missed else sum(one for one in missed if one) / len(decisions),
        sum(result.metrics.solver_failures for result in results),
        mean(lengths) if limits.steps is None else bounded_mean(lengths, (1.0, limits.steps)),
        success_rate(np.array(cleanly)) if scored and None not in cleanly else None,
        worst_decile(returns, limits.returns),
        None if restricted is None else bounded_mean(restricted, (1.0, float(limits.steps or 1))),
        bounded_mean(efficiency, (0.0, 1.0)) if scored and np.isfinite(efficiency).all() else None,
        float(cold.max()) if len(cold) else None,
        timed[0].worlds,
        timed[0].workers,
        float(decisions.mean()),
        mean(np.array([np.nansum(result.decision_ms) / 1e3 for result in timed])),
    )


def _training_cost(policy: Policy) -> TrainingCost:
    """What a policy's training took: the steps that it tells are decisions, unless its card knows better."""
    steps, minutes = policy.training_steps, getattr(policy, "training_minutes", None)
    known = getattr(policy, "training_cost", None)
    return known if isinstance(known, TrainingCost) else TrainingCost(steps, minutes, steps or None)


def _mean_metric(name: str, results: Sequence[EpisodeResult]) -> Estimate | None:
    values = [getattr(result.metrics, name) for result in results]
    return mean(_known(float(value) for value in values if value is not None))


def _known(values: Iterable[float]) -> NDArray[np.float64]:
    return np.array([value for value in values if not np.isnan(value)])


def _paired(counted: dict[str, list[EpisodeResult]], scored: bool, limits: Limits) -> list[PairedDifference]:
    return [
        paired_difference(
            a,
            b,
            _both(counted[a], counted[b], lambda result: bool(result.success)) if scored else None,
            _both(counted[a], counted[b], lambda result: result.total_reward),
            _restricted(counted[a], counted[b], limits) if scored else None,
            limits.returns,
            limits.steps,
        )
        for a, b in itertools.combinations(counted, 2)
        if counted[a] and counted[b]
    ]


def _restricted(
    a: list[EpisodeResult], b: list[EpisodeResult], limits: Limits
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    fewest = min(len(a), len(b))
    first, second = limits.restricted(a[:fewest]), limits.restricted(b[:fewest])
    return None if first is None or second is None else (first, second)


def _both(
    a: list[EpisodeResult], b: list[EpisodeResult], value: Callable[[EpisodeResult], float]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """A value of the episodes that both played, which are the first ones, since neither has gaps."""
    pairs = list(zip(a, b, strict=False))
    return np.array([value(first) for first, _ in pairs]), np.array([value(second) for _, second in pairs])
