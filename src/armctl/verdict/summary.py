"""Summarises a comparison's episodes, for each policy and each pair of policies."""

import functools
import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.agents.costs import TrainingCost, mean_cost
from armctl.core.kinds import Kind, kind_of
from armctl.envs import ERROR, UNSTABLE, privilege_in_words
from armctl.episodes.table import EpisodeTable
from armctl.rollout.decision_times import Machines, comparable_times, setting_in_words
from armctl.runtime.provenance import Run, earlier_looks
from armctl.stats.difference import Difference
from armctl.stats.intervals import Bounds, Estimate, bounded_mean, median, success_rate, worst_decile
from armctl.stats.trainings import mean_over_trainings
from armctl.verdict.decision_summary import DecisionTimes, decision_times
from armctl.verdict.facts import Facts
from armctl.verdict.scores import Limits, by_learner, pairs_of, scores_of
from armctl.verdict.tables import milliseconds

if TYPE_CHECKING:
    import pandas as pd

METRICS = (
    "path_length", "smoothness", "joint_jerk_max", "joint_jerk_rms", "tip_jerk_max", "tip_jerk_rms",
    "range_use", "speed_use", "torque_use", "energy", "clearance", "contacts",
)  # fmt: skip
"""The fields of `armctl.episodes.metrics.Metrics` whose means are in the summary."""
MIN_PLANNING = 3.0
"""Times the median decision from which on an episode's first one is told beside it: it plans."""


@dataclass(frozen=True, kw_only=True)
class PlayedEpisodes:
    """A policy, and the episodes that it played."""

    policy: str
    sees: str
    training: TrainingCost
    planned: int
    """Number of requested episodes."""
    episodes: int
    """Number of episodes that count: feasible ones, up to the first that was not finished; of each training."""
    infeasible: int
    """Number of episodes that are labelled infeasible: they are left out of all figures, whoever won them."""
    outcomes: dict[str, int]
    """Numbers of episodes by outcome, most frequent first."""


@dataclass(frozen=True, kw_only=True)
class Performance:
    """Figures of how well a policy did."""

    success: Estimate | None
    """None if the environment does not say what a success is."""
    episode_return: Estimate | None
    """None if a policy failed in an episode, and the least possible return is unknown."""
    steps_to_goal: Estimate | None
    """Mean over successful episodes, which flatters a policy that wins only the easy ones: see `restricted_steps`."""
    optimality_gap: Estimate | None
    """Median relative excess of successful episodes' lengths over the least possible, where that is known."""
    tracking_error: Estimate | None
    """m, mean distance to a moving target after it was first reached."""
    metrics: dict[str, Estimate | None]
    """Means of `METRICS` over successful episodes, or over all if success is unknown. Only `contacts` has an interval,
    since the others have no bounds."""
    solver_failures: int
    """Number of control steps in which the controller's solver failed, if it counts them."""
    intervention_share: float | None = None
    """Share of all control steps in which a safety filter changed the action; None without a filter."""
    intervention_size: float | None = None
    """Mean change in these steps, relative to the actions' range; None without any."""
    length: Estimate | None = None
    """Mean number of control steps, over all episodes."""
    clean_success: Estimate | None = None
    """Rate of `clean` successes; None if contacts are unknown."""
    worst_decile: Estimate | None = None
    """Mean of the worst tenth of the returns: the conditional value at risk."""
    median_return: Estimate | None = None
    """Median return if the return has no stated bounds: it then has an interval, and the mean has none."""
    restricted_steps: Estimate | None = None
    """Mean steps to the goal over all episodes, a failure counting as the time limit; None without a limit."""
    efficiency: Estimate | None = None
    """Mean of success times least possible length over length (SPL, Anderson et al. 2018, arXiv:1807.06757)."""


@dataclass(frozen=True, kw_only=True)
class PolicySummary(DecisionTimes, Performance, PlayedEpisodes):
    """One policy over all its episodes."""

    trainings: dict[str, float] = field(default_factory=dict)
    """Success rate, or return if success is unknown, of each training of a group, by its name in `episodes.csv`.

    The group's means have intervals over trainings and episodes, its other figures are of all episodes together."""
    spared: tuple[str, ...] = ()
    """Disturbances that do not affect it: it reads nothing that they change. No pair with it is tested or ranked."""
    between_seed_std: float | None = None
    """Standard deviation of these between trainings, without the part due to their episodes."""
    if_normal: Estimate | None = None
    """Mean of these with Student's interval, which holds if trainings vary normally; nothing is concluded from it.

    None if the score has no bounds."""
    family: str = ""
    """Kind of method that the policy declares, such as `MPC`; of another, its name."""
    foresight: tuple[str, ...] = ()
    """Foresight, such as `pedestrians`."""
    interface: dict[str, str] = field(default_factory=dict)
    """Interface as `PolicyFacts` has it."""
    isolated: bool = False
    """True if it played in a process of its own, which got observations only."""
    transport_ms: float | None = None
    """Time that messages take beside a decision, median; None if that was not measured."""
    kind: str | None = None
    """Kind of policy as `PolicyFacts` has it."""

    @property
    def side(self) -> Kind:
        """Kind on which verdicts count it."""
        return kind_of(self.kind, self.training.steps > 0)

    @property
    def interventions(self) -> list[str]:
        """Share and size of the changes that a safety filter made, in words; nothing without a filter."""
        if self.intervention_share is None:
            return []
        size = "" if self.intervention_size is None else f", by {100 * self.intervention_size:.2g} % of its range"
        return [f"safety filter: action changed in {100 * self.intervention_share:.2g} % of the control steps{size}"]

    @property
    def isolation(self) -> list[str]:
        """Meaning of the decision times of a policy in a process of its own, in words; nothing of others."""
        transport = f", without {self.transport_ms:.2g} ms of transport" if self.transport_ms else ""
        return [f"isolated: decision times as measured in its own process{transport}"] * self.isolated

    @property
    def effort(self) -> list[str]:
        """Effort of its training and tuning, in words; empty for a policy without either, as far as is recorded."""
        trained = f"{self.policy} was trained for {self.training}{' each' * bool(self.trainings)}"
        tuned = f"{self.policy} was tuned in {self.training.tuning}"
        return [trained] * (self.training.steps > 0) + [tuned] * (self.training.tuning is not None)

    @property
    def decision_time(self) -> str:
        """Median and 99th percentile of a decision, in words; with the first one of an episode if that takes longer."""
        if math.isnan(self.decision_ms_p50):
            return "unknown"
        if math.isnan(self.decision_ms_p99):
            return milliseconds(self.decision_ms_p50)
        details = [f"99th percentile {milliseconds(self.decision_ms_p99)}"]
        if self.first_decision_ms is not None and self.first_decision_ms > MIN_PLANNING * self.decision_ms_p50:
            details.append(f"reset and first decision {milliseconds(self.first_decision_ms)}")
        return f"{milliseconds(self.decision_ms_p50)} ({', '.join(details)})"

    @property
    def timing(self) -> str:
        """Kind of the decision times, in words; empty for latencies, by which deadlines can be judged."""
        return setting_in_words(self.worlds, self.workers)

    @property
    def privilege(self) -> str:
        """Privilege and foresight, in words."""
        return privilege_in_words(self.sees, self.foresight)

    @property
    def knowledge(self) -> tuple[str, str]:
        """Privilege, as tables write it: on two lines, of which the second may be empty."""
        first, plus, more = self.privilege.partition(" + ")
        return first, plus.lstrip() + more

    @property
    def unstable(self) -> int:
        """Number of episodes whose physics failed: infinite numbers, or none. They are no successes."""
        return self.outcomes.get(UNSTABLE, 0)


def summarise(
    results: EpisodeTable, facts: Facts, runs: Iterable[Run] = ()
) -> tuple[list[PolicySummary], list[Difference]]:
    """Return summaries of policies and of pairs. `results` are sorted by policy and episode.

    Each group of trainings counts as one policy; one of which a training has not finished an episode has no figures. If
    the possible returns are unknown, means of returns have neither intervals nor tests: no number of episodes tells
    what a disaster costs that none of them had. Pairs with a policy that a disturbance spares are left out. Times of
    `runs` on different machines are not pooled. What is concluded of pairs holds at any number of episodes if the
    comparison could stop early, or an earlier run told a verdict.
    """
    counted, infeasible = counted_results(results, facts.first_episode)
    finished = results[results.column("outcome") != ERROR]
    scored = any(value is not None for (value,) in (finished if len(finished) else results).counts("success"))
    runs = list(runs)
    limits, machines = Limits(facts.return_bounds, facts.time_limit), Machines.of(runs, results)
    trained = by_learner(counted, facts.policies, facts.groups)
    summaries = []
    for name, trainings in trained.items():
        members = [facts.policies[member] for member in trainings]
        costs = [member.training_cost for member in members]
        construction_ms = max(
            (spent for member in members if (spent := member.construction_ms) is not None), default=None
        )
        together = functools.reduce(EpisodeTable.together, trainings.values())
        summary = PolicySummary(
            policy=name,
            sees=members[0].sees,
            training=costs[0] if len(costs) == 1 else mean_cost(costs),
            planned=facts.planned,
            episodes=len(together),
            infeasible=infeasible,
            outcomes=dict(
                Counter({name: count for (name,), count in together.counts("outcome").items()}).most_common()
            ),
            spared=members[0].spared,
            family=members[0].family or name,
            foresight=members[0].foresight,
            interface=members[0].interface,
            isolated=all(member.isolated for member in members),
            kind=members[0].kind,
            transport_ms=members[0].transport_ms,
            **vars(_performance(together, scored, limits, facts.unknown)),
            **vars(decision_times(comparable_times(together, machines), construction_ms, bool(facts.sources))),
        )
        if len(trainings) > 1:
            summary = _of_group(summary, trainings, scored, limits)
        summaries.append(summary)
    affected = {summary.policy: list(trained[summary.policy].values()) for summary in summaries if not summary.spared}
    looks = earlier_looks([run for run in runs if not run.overwritten])  # nothing corrects for those at other episodes
    any_number = facts.paired and (facts.at_most is not None or bool(looks))
    return summaries, pairs_of(affected, scored, limits, facts.paired, any_number)


def counted_results(results: EpisodeTable, first: int = 0) -> tuple[dict[str, EpisodeTable], int]:
    """Return the results that count, by policy and episode, and the number of infeasible episodes, which do not.

    `first` is the number of the first episode that was asked for. Of a policy that was cut short, only the episodes
    before the first unfinished one count: with many worlds, short episodes end first, so that all finished ones would
    be a biased sample.
    """
    infeasible = np.unique(results.column("episode")[~results.column("feasible").astype(bool)])
    counted = {}
    for name, table in results.by_policy().items():
        episodes = table.column("episode")
        unbroken = episodes == first + np.arange(len(episodes))  # one that is missing shifts all later ones
        counted[name] = table[unbroken & ~np.isin(episodes, infeasible)]
    return counted, len(infeasible)


def counted_rows(results: EpisodeTable, first: int = 0) -> "pd.DataFrame":
    """Return the rows of `episodes.csv` of the results that count, from the episode `first` on.

    The return of an episode in which the policy failed is -inf: less than any other.
    """
    counted, _ = counted_results(results, first)
    rows = functools.reduce(EpisodeTable.together, counted.values(), results[:0]).frame()
    return rows.assign(**{"return": rows["return"].where(rows.outcome != ERROR, -math.inf)})


def _performance(results: EpisodeTable, scored: bool, limits: Limits, unknown: Collection[str]) -> Performance:
    def scores(score: str) -> NDArray[np.float64]:
        return np.asarray(scores_of(score, [results], limits)[0])

    won = results[results.won]
    returns = scores("episode_return")
    finite = bool(np.isfinite(returns).all())
    changed = results.column("intervention_share") * results.column("length")
    sizes = results.column("intervention_size")[changed > 0] * changed[changed > 0]
    steps = (1.0, float(limits.steps)) if limits.steps else None
    has_contacts = (None,) not in results.counts("contacts")
    efficiency, has_steps = scores("efficiency"), "steps" not in unknown
    return Performance(
        success=success_rate(scores("success") == 1) if scored else None,
        episode_return=_mean(returns, limits.returns) if finite else None,
        steps_to_goal=_mean(won.column("length"), steps) if has_steps else None,
        optimality_gap=median(_finite(results.optimality_gap)),
        tracking_error=_mean(_finite(results.column("tracking_error"))),
        metrics={name: _mean_metric(name, won if scored else results, limits.steps) for name in METRICS},
        solver_failures=sum(failures * count for (failures,), count in results.counts("solver_failures").items()),
        intervention_share=_ratio(np.nansum(changed), results.column("length")[~np.isnan(changed)].sum()),
        intervention_size=_ratio(sizes.sum(), changed[changed > 0].sum()),
        length=_mean(scores("length"), steps) if has_steps else None,
        clean_success=success_rate(scores("clean_success") == 1) if scored and has_contacts else None,
        worst_decile=worst_decile(returns, limits.returns) if finite else None,
        median_return=median(returns) if limits.returns is None and "return" not in unknown else None,
        restricted_steps=_mean(scores("restricted_steps"), steps) if scored and limits.steps else None,
        efficiency=bounded_mean(efficiency, (0.0, 1.0)) if scored and np.isfinite(efficiency).all() else None,
    )


def _ratio(total: float, count: float) -> float | None:
    """Return a mean; None if it is of nothing."""
    return float(total / count) if count else None


def _of_group(
    pooled: PolicySummary, trainings: Mapping[str, EpisodeTable], scored: bool, limits: Limits
) -> PolicySummary:
    """Return the summary of several trainings from that of all their episodes: intervals are over trainings as well."""
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
            changes |= {"trainings": rates, "between_seed_std": crossed.between_seed_std, "episodes": values.shape[1]}
            changes["if_normal"] = crossed.if_normal if possible else None
    metrics = {name: value and replace(value, low=None, high=None) for name, value in pooled.metrics.items()}
    return replace(pooled, metrics=metrics, **changes)


def _mean_metric(name: str, results: EpisodeTable, steps: int | None) -> Estimate | None:
    bounds = (0.0, float(steps)) if name == "contacts" and steps else None
    return _mean(_finite(results.column(name)), bounds)


def _mean(values: ArrayLike, bounds: Bounds | None = None) -> Estimate | None:
    """Return a mean, without an interval if the values have no bounds: rare values may not have occurred."""
    values = np.asarray(values, dtype=float)
    if bounds is not None:
        return bounded_mean(values, bounds)
    return Estimate(float(values.mean()), None, None) if len(values) else None


def _finite(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return the values that are neither None nor NaN."""
    numbers: NDArray[np.float64] = values.astype(float)
    return numbers[~np.isnan(numbers)]
