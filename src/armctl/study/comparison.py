"""The result of a comparison: of one cell of a study."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any

from armctl.core.registration import bare_id
from armctl.episodes.stored import MEASURED
from armctl.episodes.table import EpisodeTable
from armctl.policies import learners
from armctl.rollout.decision_times import Machines, load_notes, timing_notes, without_deadline_verdicts
from armctl.runtime.provenance import Run, argument_notes, earlier_looks, overwritten_looks
from armctl.stats.difference import Difference
from armctl.stats.robustness import GROUP
from armctl.verdict.facts import Facts, PolicyFacts
from armctl.verdict.notebook import Displayed
from armctl.verdict.notes import certificate_notes, first_step_notes, motion_notes, unclean_notes
from armctl.verdict.scores import by_learner
from armctl.verdict.sentences import Verdict, verdict
from armctl.verdict.summary import PolicySummary, counted_results, counted_rows, summarise
from armctl.verdict.summary_tables import details, difference_table, policy_table
from armctl.verdict.tables import Document, Remark, Table

if TYPE_CHECKING:
    import pandas as pd

NO_SUCCESS_SIGNAL = (
    "{env} does not say what a success is: the verdict goes by return. --success-key or --success-return does."
)
UNBOUNDED = (
    "The possible returns are unknown, so that their means and worst tenths have neither intervals nor tests: a "
    "disaster that none of these episodes had may cost anything. --return-bounds LOW HIGH states the bounds."
)


FIXED = (
    "Intervals of single policies are for a fixed number of episodes; those of differences hold at any number of "
    "them{groups}."
)


@dataclass(repr=False)
class Comparison(Displayed):
    """The result of a comparison. After an interrupt or a failure, it covers the finished episodes."""

    identity: Mapping[str, Any]
    """Everything that determines the episodes."""
    env_options: Mapping[str, Any]
    facts: Facts
    results: EpisodeTable
    """Every episode, by policy and episode."""
    runs: Sequence[Run] = ()
    """Runs that played the episodes, or that printed another verdict."""
    policies: list[PolicySummary] = field(default_factory=list)
    differences: list[Difference] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    """Remarks: about the environment, and about what the figures depend on."""
    doubts: list[str] = field(default_factory=list)
    """Reasons to doubt the pairs of episodes that were played elsewhere."""
    tracebacks: dict[str, str] = field(default_factory=dict)
    """Tracebacks of the failures, where there are any; of episodes that were played now."""

    @property
    def env(self) -> str:
        """The environment's id."""
        return str(self.identity["env"])

    @property
    def seed(self) -> int:
        """The seed of the episodes."""
        return int(self.identity["seed"])

    @property
    def failures(self) -> dict[str, str]:
        """Error messages: see `Facts.failures`."""
        return self.facts.failures

    @property
    def interrupted(self) -> bool:
        """True if Ctrl-C ended it."""
        return self.facts.interrupted

    @property
    def resumed(self) -> int:
        """Number of episodes that an earlier run had finished."""
        return self.facts.resumed

    @property
    def looks(self) -> list[int]:
        """Numbers of episodes after which earlier runs printed a verdict; the present verdict names them."""
        return earlier_looks(self.runs) if self.policies else []

    @property
    def stopped_of(self) -> int | None:
        """Largest number of episodes of a comparison that was decided before that; None if it did not stop early."""
        at_most = self.facts.at_most
        return at_most if at_most is not None and self.facts.planned < at_most else None

    @cached_property
    def episodes(self) -> "pd.DataFrame":
        """One row per policy and episode, with the columns of `episodes.csv`. It is made on first use."""
        return self.results.frame()

    @cached_property
    def counted_rows(self) -> "pd.DataFrame":
        """The rows of `episodes` that count; see `armctl.verdict.summary.counted_rows`."""
        return counted_rows(self.results, self.facts.first_episode)

    @property
    def names(self) -> list[str]:
        """Names of all policies that were asked for, in order; a group of trainings counts as one."""
        return learners(list(self.identity["policies"]), self.facts.groups)

    @cached_property
    def players(self) -> dict[str, PolicyFacts]:
        """Facts about each policy with episodes that count; about a group, those of its first training."""
        counted, _ = counted_results(self.results, self.facts.first_episode)
        trained = by_learner(counted, self.facts.policies, self.facts.groups)
        return {name: self.facts.policies[next(iter(trainings))] for name, trainings in trained.items()}

    @cached_property
    def counted(self) -> dict[str, EpisodeTable]:
        """The episodes that count, by policy; policies without any are left out. Those of a group: of all trainings."""
        counted, _ = counted_results(self.results, self.facts.first_episode)
        trained = by_learner(counted, self.identity["policies"], self.facts.groups)
        names = [policy.policy for policy in self.policies]
        return {name: reduce(EpisodeTable.together, trained[name].values()) for name in names}

    @property
    def unclean(self) -> list[str]:
        """Remarks about successes that are not clean."""
        is_torque = self.facts.env_options.get("control") == "torque"
        return unclean_notes(self.counted, is_torque) if len(self.results) else []

    @property
    def verdict(self) -> Verdict | None:
        """Verdict on the better policy, by how much and at what cost; None for a single policy."""
        if len(self.policies) < 2:
            return None
        overwritten, facts = overwritten_looks(self.runs), self.facts
        return verdict(
            self.policies, self.differences, facts.baseline, facts.margin, self.looks, overwritten, self.stopped_of
        )

    def document(self) -> Document:
        """Return the verdict, the tables and all remarks."""
        parts: list[Table | Remark] = []
        verdict = self.verdict
        if verdict:
            parts += [Remark(sentence, "verdict") for sentence in (verdict.result, verdict.cost) if sentence]
        parts += [Remark(doubt, "note") for doubt in self.doubts]
        if self.policies:
            parts.append(policy_table(self.env, self.seed, self.policies, self.facts.disqualified, self.facts.sources))
        parts += [details(policy) for policy in self.policies]
        if self.differences:
            parts.append(difference_table(self.differences, self.facts.baseline))
        if verdict and verdict.context:
            parts.append(Remark(verdict.context))
        if self.policies and (infeasible := self.policies[0].infeasible):
            count = f"{infeasible} episodes are labelled infeasible"
            parts.append(Remark(f"{count}; they are left out of all figures, whoever wins them."))
        parts += [Remark(note, "note") for note in (*self.notes, *self.unclean)]
        parts += [Remark(message, "problem") for message in self.failures.values()]
        if self.resumed:
            parts.append(Remark(f"{self.resumed} episodes were finished by an earlier run."))
        if self.interrupted:
            parts.append(Remark("Interrupted.", "note"))
        parts += self._incomplete()
        return Document(parts, {"env": self.env, "env_options": self.facts.env_options, "seed": self.seed})

    def _incomplete(self) -> list[Remark]:
        """Return a remark on each policy with fewer episodes than others, and on those that were needed no longer."""
        planned = [] if self.facts.sources else self.policies
        fewer = [policy for policy in planned if policy.episodes < policy.planned - policy.infeasible]
        needless = []
        if self.facts.at_most is not None and not self.interrupted:
            needless = [policy.policy for policy in fewer if policy.policy not in self.failures]
        remarks = [
            f"{policy.policy} was cut short: its figures are over the first {policy.episodes} of {policy.planned} "
            "episodes."
            for policy in fewer
            if policy.policy not in needless
        ]
        if needless:
            remarks.append(f"Stopped earlier, as they represent no kind: {', '.join(needless)}.")
        return [Remark(remark, "note") for remark in remarks]

    def __repr__(self) -> str:
        names = ", ".join(policy.policy for policy in self.policies) or "no policy"
        conclusion = f": {self.verdict}" if self.verdict else ""
        failed = "".join(f"; {failure}" for failure in self.failures.values())
        return f"<Comparison of {names} in {self.env}, seed {self.seed}{conclusion}{failed}>"


def concluded(
    identity: Mapping[str, Any],
    env_options: Mapping[str, Any],
    facts: Facts,
    results: EpisodeTable,
    runs: Sequence[Run],
    tracebacks: dict[str, str] | None = None,
) -> Comparison:
    """Return the result of a cell from its identity, facts, episodes and runs."""
    latencies = facts.real_time is None or facts.real_time["latency"] == MEASURED
    results = without_deadline_verdicts(results, runs) if latencies and len(results) else results
    comparison = Comparison(identity, env_options, facts, results, runs, notes=[*facts.notes])
    comparison.tracebacks = tracebacks or {}
    if not len(results):
        return comparison
    comparison.policies, comparison.differences = summarise(results, facts, runs)
    counted, _ = counted_results(results, facts.first_episode)
    by_return = bool(comparison.policies) and comparison.policies[0].success is None
    any_number = [pair.any_number for pair in comparison.differences]
    comparison.notes += [
        *([] if facts.return_bounds or "return" in facts.unknown else [UNBOUNDED]),
        *([FIXED.format(groups=f", but for {GROUP}" * (not all(any_number)))] if any(any_number) else []),
        *certificate_notes(results),
        *first_step_notes(counted),
        *motion_notes(results, facts.control_period),
        *timing_notes(((name, table) for name, table in counted.items() if table), Machines.of(runs, results)),
        *([NO_SUCCESS_SIGNAL.format(env=bare_id(comparison.env))] if by_return else []),
        *(load_notes(results, runs) if latencies else []),
        *(argument_notes(runs, facts.baseline, facts.margin) if comparison.differences else []),
    ]
    return comparison
