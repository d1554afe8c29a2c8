"""Summarises a comparison's episodes, for each policy and each pair of policies."""

import functools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.agents.costs import TrainingCost, mean_cost
from armctl.envs import ERROR, SEES
from armctl.envs.vector import UNSTABLE
from armctl.episodes.record import EpisodeResult
from armctl.episodes.table import EpisodeTable, table_of
from armctl.policies import Policy
from armctl.rollout.decision_times import Machines, comparable_times, setting_in_words
from armctl.runtime.provenance import Run
from armctl.stats.intervals import Bounds, Estimate, bounded_mean, median, success_rate, worst_decile
from armctl.stats.paired import PairedDifference
from armctl.stats.trainings import mean_over_trainings
from armctl.verdict.scores import Limits, by_learner, pairs_of, scores_of

METRICS = (
    "path_length", "smoothness", "range_use", "speed_use", "torque_use", "energy", "clearance", "contacts",
)  # fmt: skip
"""The fields of `armctl.episodes.metrics.Metrics` whose means are in the summary."""


STUCK_PATH, STUCK_SECONDS = 0.01, 1.0
"""m and s: who moves the end-effector or the rover by less than this in an episode of at least so long, and does not
win, commands next to nothing. Targets are farther than 1 cm, and even a slow motion covers that in 1 s."""


@dataclass(frozen=True)
class PolicySummary:
    """One policy over all its episodes."""

    policy: str
    sees: str
    training: TrainingCost
    planned: int
    """Number of episodes asked for."""
    episodes: int
    """Number of episodes that count: feasible ones, up to the first that was not finished; of each training."""
    infeasible: int
    """Number of episodes that are labelled infeasible: they are left out of all figures, whoever won them."""
    outcomes: dict[str, int]
    """How the episodes ended, most frequent first."""
    success: Estimate | None
    """None if the environment does not say what a success is."""
    episode_return: Estimate | None
    """None if a policy failed in an episode, and nobody knows the least possible return."""
    steps_to_goal: Estimate | None
    """Mean over successful episodes, which flatters whoever wins only the easy ones: see `restricted_steps`."""
    optimality_gap: Estimate | None
    """Median relative excess of successful episodes' lengths over the least possible, where that is known."""
    tracking_error: Estimate | None
    """m, mean distance to a moving target after it was first reached."""
    metrics: dict[str, Estimate | None]
    """Means of `METRICS` over successful episodes, or over all if success is unknown; without intervals but for
    `contacts`, since the others have no bounds."""
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
    median_return: Estimate | None = None
    """Where the possible returns are unknown: it has an interval all the same, unlike their mean and worst tenth."""
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
    """Of warm decisions, with the resets spread over them: who plans at the reset is not quicker than who plans at the
    first step. None in results of older versions, like the next one."""
    decision_seconds: Estimate | None = None
    """Mean over episodes of the time of the reset and all decisions, the cold one included."""
    reset_ms: float | None = None
    """Median over episodes; None in results of older versions, in which it is part of the first decision."""
    construction_ms: float | None = None
    """How long it took to make the policy in the process that played, of several the longest; divided by the number of
    controllers, if there is one for each world. None in results of older versions."""
    trainings: dict[str, float] = field(default_factory=dict)
    """Of a group: each training's success rate, or return if success is unknown, by its name in `episodes.csv`.

    The group's means have intervals over trainings and episodes, its other figures are of all episodes together."""
    spared: tuple[str, ...] = ()
    """The disturbances that do not reach it: it reads nothing that they change. No pair with it is tested or ranked."""
    between: float | None = None
    """Standard deviation of these between trainings, without the part due to their episodes."""
    if_normal: Estimate | None = None
    """Mean of these with Student's interval, which holds if trainings vary normally; nothing is concluded from it.

    None if the score has no bounds."""

    @property
    def learned(self) -> bool:
        """Whether it was trained."""
        return self.training.steps > 0

    @property
    def effort(self) -> list[str]:
        """What its training and tuning took, in words; empty for a policy without either, as far as is recorded."""
        trained = f"{self.policy} was trained for {self.training}{' each' * bool(self.trainings)}"
        tuned = f"{self.policy} was tuned in {self.training.tuning}"
        return [trained] * self.learned + [tuned] * (self.training.tuning is not None)

    @property
    def decision_ms(self) -> float:
        """Mean time of a warm decision, planning at resets included, or the median in results of older versions."""
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
    groups: Mapping[str, Sequence[str]] | None = None,
    spared: Mapping[str, tuple[str, ...]] | None = None,
    runs: Iterable[Run] = (),
) -> tuple[list[PolicySummary], list[PairedDifference]]:
    """Summaries of policies and of pairs. `results` are sorted by policy and episode.

    Each of the `groups`, several trainings by their names, counts as one policy; a group of which one has not finished
    an episode has no figures. `return_bounds` are the least and largest possible return. If they are unknown, means of
    returns have neither intervals nor tests: no number of episodes tells what a disaster costs that none of them had.
    `time_limit` is the largest number of control steps of an episode. `spared` are the disturbances that do not reach a
    policy, by its name: pairs with such a policy are left out. Times of `runs` on different machines are not pooled.
    """
    table = table_of(results)
    counted, infeasible = counted_results(table)
    success = table.column("success")[table.column("outcome") != ERROR].tolist()
    scored = any(known is not None for known in success or table.column("success").tolist())
    limits, machines = Limits(return_bounds, time_limit), Machines.of(runs, table)
    trained = by_learner(counted, policies, groups or {})
    found = []
    for name, trainings in trained.items():
        policy = policies[name if name in policies else next(iter(trainings))]
        together = functools.reduce(EpisodeTable.together, trainings.values())
        summary = _summary(name, policy, planned, infeasible, together, scored, limits, machines)
        if len(trainings) > 1:
            summary = _of_group(summary, trainings, scored, limits)
            summary = replace(summary, training=mean_cost([training_cost_of(policies[one]) for one in trainings]))
        found.append(replace(summary, spared=(spared or {}).get(next(iter(trainings)), ())))
    reached = {one.policy: list(trained[one.policy].values()) for one in found if not one.spared}
    return found, pairs_of(reached, scored, limits)


def counted_results(results: EpisodeTable) -> tuple[dict[str, EpisodeTable], int]:
    """The results that count, by policy and episode, and the number of infeasible episodes, which do not.

    Of a policy that was cut short, only the episodes before the first unfinished one count: with many worlds, short
    episodes end first, so that all finished ones would be a biased sample.
    """
    infeasible = np.unique(results.column("episode")[~results.column("feasible").astype(bool)])
    counted = {}
    for name, played in results.by_policy().items():
        episodes = played.column("episode")
        unbroken = episodes == np.arange(len(episodes))  # one that is missing shifts all later ones
        counted[name] = played[unbroken & ~np.isin(episodes, infeasible)]
    return counted, len(infeasible)


def certificate_notes(results: Sequence[EpisodeResult]) -> list[str]:
    """A remark if policies won episodes that are labelled infeasible, which do not count for them."""
    table = table_of(results)
    won = table[table.won & ~table.column("feasible")]
    if not won:
        return []
    by = ", ".join(f"{len(its)} by {name}" for name, its in won.by_policy().items())
    episodes = len(np.unique(won.column("episode")))
    return [f"Episodes labelled infeasible that were won, so that the certificate was too strict: {episodes} ({by})."]


def motion_notes(results: EpisodeTable, control_period: float | None) -> list[str]:
    """Remarks about policies that hardly moved the robot in episodes that they did not win."""
    if control_period is None:
        return []
    length = results.column("length")
    lost = ~results.won & (results.column("outcome") != ERROR) & (length * control_period >= STUCK_SECONDS)
    stuck = results[lost & (results.column("path_length") < STUCK_PATH)]
    notes = []
    for name, played in results.by_policy().items():
        if count := int((stuck.column("policy") == name).sum()):
            notes.append(
                f"{name} hardly moved in {count} of {len(played)} episodes (a path below {100 * STUCK_PATH:g} cm in at "
                f"least {STUCK_SECONDS:g} s, and no success): it may be stuck."
            )
    return notes


def _summary(
    name: str,
    policy: Policy,
    planned: int,
    infeasible: int,
    results: EpisodeTable,
    scored: bool,
    limits: Limits,
    machines: Machines,
) -> PolicySummary:
    def scores(score: str) -> NDArray[np.float64]:
        found: NDArray[np.float64] = scores_of(score, [results], limits)[0]
        return found

    timed = comparable_times(results, machines)
    decisions = timed.warm_ms() if timed.column("length").any() else np.array([math.nan])
    resets = _known(timed.column("reset_ms"))
    mean_ms, most_ms = float(decisions.mean() + resets.sum() / len(decisions)), float(decisions.max())
    p50, p99 = np.quantile(decisions, (0.5, 0.99), overwrite_input=True).tolist()
    cold = _known(timed.column("decision_ms_cold"))
    won = results[results.won]
    missed = timed.column("missed_deadlines").tolist()
    returns = scores("episode_return")
    finite = bool(np.isfinite(returns).all())
    steps = (1.0, float(limits.steps)) if limits.steps else None
    unknown_contacts = None in results.column("contacts").tolist()
    efficiency = scores("efficiency")
    return PolicySummary(
        name,
        policy.sees,
        training_cost_of(policy),
        planned,
        len(results),
        infeasible,
        dict(Counter(results.column("outcome").tolist()).most_common()),
        success_rate(scores("success") == 1) if scored else None,
        _mean(returns, limits.returns) if finite else None,
        _mean(won.column("length"), steps),
        median(_known(results.optimality_gap)),
        _mean(_known(results.column("tracking_error"))),
        {name: _mean_metric(name, won if scored else results, limits.steps) for name in METRICS},
        p50,
        p99,
        most_ms,
        None if None in missed else sum(one for one in missed if one) / len(decisions),
        sum(results.column("solver_failures").tolist()),
        _mean(scores("length"), steps),
        success_rate(scores("clean_success") == 1) if scored and not unknown_contacts else None,
        worst_decile(returns, limits.returns) if finite else None,
        median(returns) if limits.returns is None else None,
        _mean(scores("restricted_steps"), steps) if scored and limits.steps else None,
        bounded_mean(efficiency, (0.0, 1.0)) if scored and np.isfinite(efficiency).all() else None,
        float(cold.max()) if len(cold) else None,
        timed[0].worlds,
        timed[0].workers,
        mean_ms,
        _mean(timed.decision_seconds()),
        float(np.median(resets)) if len(resets) else None,
    )


def _of_group(
    pooled: PolicySummary, trainings: Mapping[str, EpisodeTable], scored: bool, limits: Limits
) -> PolicySummary:
    """The summary of several trainings, from that of all their episodes: intervals are over trainings as well."""
    steps = float(limits.steps or 1)
    bounds: dict[str, Bounds | None] = {
        "success": (0.0, 1.0),
        "clean_success": (0.0, 1.0),
        "efficiency": (0.0, 1.0),
        "episode_return": limits.returns,
        "restricted_steps": (1.0, steps),
        "length": (1.0, steps) if limits.steps else None,
    }
    changes: dict[str, Any] = {
        name: replace(value, low=None, high=None) for name, value in vars(pooled).items() if isinstance(value, Estimate)
    }
    main = "success" if scored else "episode_return"
    for name, possible in bounds.items():
        if getattr(pooled, name) is None:
            continue
        values = scores_of(name, list(trainings.values()), limits)
        crossed = mean_over_trainings(values, possible)
        changes[name] = crossed.mean
        if name == main:
            rates = dict(zip(trainings, values.mean(axis=1).tolist(), strict=True))
            changes |= {"trainings": rates, "between": crossed.between, "episodes": values.shape[1]}
            changes["if_normal"] = crossed.if_normal if possible else None
    metrics = {name: value and replace(value, low=None, high=None) for name, value in pooled.metrics.items()}
    return replace(pooled, metrics=metrics, **changes)


def training_cost_of(policy: Policy) -> TrainingCost:
    """What a policy's training took: the steps that it tells are decisions, unless its card knows better."""
    steps, minutes = policy.training_steps, getattr(policy, "training_minutes", None)
    known = getattr(policy, "training_cost", None)
    return known if isinstance(known, TrainingCost) else TrainingCost(steps, minutes, steps or None)


def _mean_metric(name: str, results: EpisodeTable, steps: int | None) -> Estimate | None:
    bounds = (0.0, float(steps)) if name == "contacts" and steps else None
    return _mean(_known(results.column(name)), bounds)


def _mean(values: ArrayLike, bounds: Bounds | None = None) -> Estimate | None:
    """A mean, without an interval if the values have no bounds: nobody knows what was too rare to be seen."""
    values = np.asarray(values, dtype=float)
    if bounds is not None:
        return bounded_mean(values, bounds)
    return Estimate(float(values.mean()), None, None) if len(values) else None


def _known(values: NDArray[Any]) -> NDArray[np.float64]:
    """Those that are neither None nor NaN."""
    numbers: NDArray[np.float64] = values.astype(float)
    return numbers[~np.isnan(numbers)]
