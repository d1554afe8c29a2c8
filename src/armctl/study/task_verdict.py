"""Verdict on a task: classical or learned, by how much, at what cost, and under which disturbances it reverses."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from armctl.core.registration import bare_id, short_name
from armctl.episodes.stored import UNDISTURBED
from armctl.policies import isolation, privileges
from armctl.runtime.provenance import looks_in_words, with_looks
from armctl.stats.across_tasks import (
    SELECTING,
    Choice,
    TaskPair,
    mean_difference,
    pairwise_by_task,
    rate_of,
    values_of,
)
from armctl.stats.correction import holm
from armctl.stats.difference import MARGIN, within
from armctl.stats.intervals import FEWEST, Estimate
from armctl.stats.robustness import listed
from armctl.study.comparison import Comparison
from armctl.study.contenders import contenders, success_table
from armctl.study.task_results import Sweep
from armctl.verdict.summary import PolicySummary, counted_rows
from armctl.verdict.tables import p_value, points, size

if TYPE_CHECKING:
    import pandas as pd

FIRST = "The first expert and the first agent of each task's line-up, which no result selected."
"""Policies of a quick suite, as tables and pages state them."""
CHOSEN = (
    "The best classical and the best learned policy. If a kind has several, every third undisturbed episode selects "
    "the best of them, and only the other episodes evaluate it: so the choice does not bias the verdict."
)
"""Rule of `armctl.stats.across_tasks.choose`, as tables and pages state it."""
CHOSEN_AT_FIRST = (
    f"The best classical and the best learned policy. If a kind has several, the first {SELECTING} undisturbed "
    "episodes select the best of them, and only the later ones evaluate it: so the choice does not bias the verdict."
)
"""The same, where cells stop when they are decided."""


@dataclass(frozen=True)
class TaskVerdict:
    """Verdict on one task, and the figures that it rests on."""

    env: str
    policies: Sequence[PolicySummary]
    """Undisturbed; empty if no episode was finished."""
    cells: "dict[str, pd.DataFrame]"
    """Success by setting, as `armctl.stats.across_tasks` takes it; empty if success is unknown."""
    labels: dict[str, str]
    """Names of settings as printed: `noise 0.02`."""
    classical: Choice | None = None
    """Choice of the best classical policy; None without any."""
    learned: Choice | None = None
    pairs: dict[str, TaskPair] = field(default_factory=dict)
    """Classical against learned, by setting."""
    looks: Sequence[int] = ()
    """The numbers of episodes after which a verdict was told before."""
    spared: dict[str, set[str]] = field(default_factory=dict)
    """The policies that a setting's disturbance does not reach: they have no success in `cells` there."""

    @property
    def task(self) -> str:
        """The task's name, as tables say it."""
        return bare_id(self.env)

    @property
    def undisturbed(self) -> TaskPair | None:
        """Classical against learned without disturbance; None unless both have played."""
        return self.pairs.get(UNDISTURBED)

    @property
    def contenders(self) -> list[str]:
        """Policies that represent the two kinds."""
        return [choice.policy for choice in (self.classical, self.learned) if choice]

    @property
    def shared_cells(self) -> "dict[str, pd.DataFrame]":
        """Cells of the settings that reach both of these."""
        contenders = set(self.contenders)
        return {name: table for name, table in self.cells.items() if contenders.isdisjoint(self.spared.get(name, ()))}

    def rate(self, choice: Choice | None) -> Estimate | None:
        """Return the undisturbed success rate of a choice, in the episodes that judge it."""
        return rate_of(self.cells[UNDISTURBED], choice) if choice and self.cells else None

    @property
    def verdict(self) -> str:
        """Sentence on the better kind without disturbance: by success, and if neither is better, by steps."""
        pair = self.undisturbed
        if pair is None:
            return self._reason_for_no_pair
        names = f"{chosen(self.classical)} against {chosen(self.learned)}"
        difference = points(pair.difference)
        if pair.episodes < FEWEST:
            return f"No verdict from {pair.episodes} episode{'s' * (pair.episodes > 1)}: {names}, success {difference}"
        margin = f"{100 * MARGIN:g} points"
        if pair.better:
            but = f", but by less than {margin}" if pair.equivalent(MARGIN) else ""
            parts = [f"{_kind(pair.better)} is better{but}: {names}, success {difference}, p = {p_value(pair.p)}"]
        elif pair.equivalent(MARGIN):
            tests = "" if within(pair.difference, MARGIN) else " (two one-sided tests at 5 %)"
            parts = [f"Equivalent in success within {margin}{tests}: {names}, {difference}"]
        else:
            parts = [f"Undecided: {names}, success {difference}, p = {p_value(pair.p)}"]
        if pair.faster and pair.steps:
            kind = _kind(pair.faster).lower()
            parts.append(f"{kind} takes {size(pair.steps)} fewer steps, p = {p_value(pair.steps_p)}")
        parts += ["on different episodes"] * (pair.wins is not None)
        if pair.anytime is not None:
            parts.append(f"after {pair.episodes:,} episodes, by a test that holds at any number of them")
        if self.looks:
            parts.append(looks_in_words(self.looks))
        return "; ".join(parts)

    @property
    def _reason_for_no_pair(self) -> str:
        if not self.policies:
            return "no episode was finished undisturbed"
        if not self.cells:
            return "the environment does not say what a success is"
        return f"no {'learned' if self.learned is None else 'classical'} policy has played"

    @property
    def reversals(self) -> str:
        """Sentence on disturbances that reverse the order, and on others that change the difference in success.

        Both only where the change itself is significant, after Holm's correction for all disturbed settings: that one
        difference is significant and another one is not shows no change. The order reverses where the other kind is
        significantly better then. Empty if nothing was disturbed, or after too few undisturbed episodes for a verdict.
        """
        undisturbed = self.undisturbed
        remaining = {name: pair for name, pair in self.pairs.items() if name != UNDISTURBED}
        if undisturbed is None or undisturbed.episodes < FEWEST or not remaining:
            return ""
        parts: list[str] = []
        for sign in (1, -1):
            reversed_order = {
                name: pair
                for name, pair in remaining.items()
                if pair.changed == pair.better == sign == -undisturbed.better
            }
            if reversed_order:
                settings = [f"{self.labels[name]} ({points(pair.difference)})" for name, pair in reversed_order.items()]
                parts.append(f"the order reverses: {_kind(sign).lower()} is better with {', '.join(settings)}")
            remaining = {name: pair for name, pair in remaining.items() if name not in reversed_order}
        for sign in (1, -1):
            shifted = {name: pair.change for name, pair in remaining.items() if pair.changed == sign and pair.change}
            settings = [f"{self.labels[name]} (by {_in_points(change)} points)" for name, change in shifted.items()]
            if settings:
                parts.append(f"the difference shifts towards {_kind(sign).lower()} with {', '.join(settings)}")
            remaining = {name: pair for name, pair in remaining.items() if pair.changed != sign}
        if remaining:
            others = "other " * bool(parts)
            several = f"{'the' if parts else 'any of the'} {len(remaining)} {others}disturbed settings"
            single = f"the {others}disturbed setting"
            parts.append(f"not shown to change in {several if len(remaining) > 1 else single}")
        return "; ".join(parts)

    @property
    def not_compared(self) -> str:
        """Sentence on settings that spare a policy which represents its kind; empty if none does."""
        shared, contenders = self.shared_cells, set(self.contenders)
        settings = [
            f"{self.labels[name]} (spares {', '.join(sorted(contenders & self.spared[name]))})"
            for name in self.cells
            if name not in shared
        ]
        return f"Not compared: {', '.join(settings)}." if settings else ""

    @property
    def costs(self) -> str:
        """Training, decision times and privileges of the policies that represent the two kinds."""
        by_name = {policy.policy: policy for policy in self.policies}
        contenders = [by_name[name] for name in self.contenders]
        parts = [words for policy in contenders for words in policy.effort]
        if not all(math.isnan(policy.decision_ms_p50) for policy in contenders):
            parts.append(f"median decision time: {_times(contenders)}")
        sees = privileges({policy.policy: policy.privilege for policy in contenders})
        apart = isolation({policy.policy: policy.isolated for policy in self.policies})
        return " ".join(filter(None, ("; ".join(parts) + "." * bool(parts), sees, apart)))

    @property
    def context(self) -> str:
        """Disturbances and costs: what follows the verdict."""
        if self.undisturbed is None:
            return ""
        reversals = f"{self.reversals[:1].upper()}{self.reversals[1:]}." if self.reversals else ""
        reversals = with_looks(reversals, self.looks)
        return " ".join(filter(None, (reversals, self.not_compared, self.costs)))


def task_verdict(sweep: Sweep) -> TaskVerdict:
    """Return the verdict on the task of a sweep."""
    tables = {
        name: table
        for name, comparison in sweep.comparisons.items()
        if (table := success_table(comparison)) is not None
    }
    labels = {name: f"{disturbance} {level:g}" for name, (disturbance, level) in sweep.settings.items()}
    labels |= {UNDISTURBED: "undisturbed"}
    spared = {
        name: {policy.policy for policy in comparison.policies if policy.spared}
        for name, comparison in sweep.comparisons.items()
    }
    plain = sweep.undisturbed
    if plain is None or UNDISTURBED not in tables:
        return TaskVerdict(sweep.env, plain.policies if plain else [], {}, labels)
    classical, trained = contenders(plain, sweep.any_number)
    verdict = TaskVerdict(sweep.env, plain.policies, tables, labels, classical, trained, {}, sweep.looks, spared)
    pairs: dict[str, TaskPair] = {}
    if classical and trained:
        pairs = pairwise_by_task(verdict.shared_cells, UNDISTURBED, classical, trained, paired=sweep.paired)
    if UNDISTURBED in pairs:
        pairs[UNDISTURBED] = _with_steps(pairs[UNDISTURBED], plain, classical, trained)
    return replace(verdict, pairs=pairs)


def _with_steps(pair: TaskPair, plain: Comparison, classical: Choice | None, learned: Choice | None) -> TaskPair:
    """Add the difference in steps to the goal, a failure counting as the time limit, if that is known."""
    time_limit = plain.facts.time_limit
    if time_limit is None or classical is None or learned is None:
        return pair
    rows = counted_rows(plain.results)
    rows = rows.assign(steps=rows.length.where(rows.success.astype(bool), time_limit))
    table = rows.pivot(index="episode", columns="policy", values="steps").astype(float)
    steps = (1.0, float(time_limit))
    scores = values_of(table, classical), values_of(table, learned)
    result = mean_difference(*scores, steps, plain.facts.paired, classical.any_number)
    return replace(pair, steps=result.estimate, steps_p=result.p) if result else pair


def holm_corrected(verdicts: Sequence[TaskVerdict]) -> list[TaskVerdict]:
    """Correct the undisturbed tests for all tasks: p-values by Holm, equivalence by Bonferroni.

    The tests of success and of steps are corrected together, as a verdict may state either.
    """
    undisturbed = {verdict.env: pair for verdict in verdicts if (pair := verdict.undisturbed)}
    tests = {(env, name): p for env, pair in undisturbed.items() for name in ("p", "steps_p")
             if (p := getattr(pair, name)) is not None}  # fmt: skip
    adjusted = dict(zip(tests, holm(list(tests.values())), strict=True))
    for env, pair in undisturbed.items():
        undisturbed[env] = replace(
            pair, p=adjusted[env, "p"], steps_p=adjusted.get((env, "steps_p")), num_comparisons=len(undisturbed)
        )
    return [
        replace(verdict, pairs=verdict.pairs | {UNDISTURBED: undisturbed[verdict.env]})
        if verdict.env in undisturbed
        else verdict
        for verdict in verdicts
    ]


def suite_headline(verdicts: Sequence[TaskVerdict]) -> tuple[str, str]:
    """Return two sentences: in which tasks each kind is better in success, and the details of the others.

    `verdicts` are corrected for all tasks, as `Study.verdicts` is. The second one may be empty.
    """
    if not verdicts:
        return "No task", ""
    by_claim: dict[str, list[str]] = {"classical is better": [], "learned is better": []}
    faster: dict[str, list[str]] = {"classical takes fewer steps": [], "learned takes fewer steps": []}
    details = []
    for verdict, task in zip(verdicts, _brief_names(verdicts), strict=True):
        claim, detail = _claim(verdict)
        by_claim.setdefault(claim, []).append(task)
        details += [f"{task}: {detail}"] if detail else []
        if verdict.undisturbed and verdict.undisturbed.faster:
            faster[f"{_kind(verdict.undisturbed.faster).lower()} takes fewer steps"].append(task)
    claims, steps = (
        [f"{claim} in {listed(tasks)}" for claim, tasks in named.items() if tasks] for named in (by_claim, faster)
    )
    looks = sorted({episodes for verdict in verdicts for episodes in verdict.looks})
    details += [*steps, *([looks_in_words(looks)] if looks else [])]
    return f"Of {len(verdicts)} task{'s' * (len(verdicts) > 1)}, by success: {'; '.join(claims)}", "; ".join(details)


def _brief_names(verdicts: Sequence[TaskVerdict]) -> list[str]:
    """Return the tasks' names without versions, unless these tell two of them apart."""
    names = [short_name(verdict.env) for verdict in verdicts]
    brief = [re.sub(r"-v\d+$", "", name) for name in names]
    return brief if len(set(brief)) == len(set(names)) else names


def _claim(verdict: TaskVerdict) -> tuple[str, str]:
    """Return what holds in a task, undisturbed, and a detail; empty without any."""
    pair = verdict.undisturbed
    if pair is None:
        return "no verdict", verdict._reason_for_no_pair
    if pair.episodes < FEWEST:
        return "no verdict", f"{pair.episodes} episode{'s' * (pair.episodes > 1)}"
    margin = f"{100 * MARGIN:g} points"
    if pair.better:
        return f"{_kind(pair.better).lower()} is better", f"by less than {margin}" if pair.equivalent(MARGIN) else ""
    if pair.equivalent(MARGIN):
        return f"equivalent within {margin}", ""
    largest = max(map(abs, pair.equivalence_interval.bounds))
    return "undecided", f"up to {math.ceil(1000 * largest) / 10:g} points apart after {pair.episodes} episodes"


def _in_points(share: Estimate) -> str:
    low, high = (100 * bound for bound in share.bounds)
    return size(Estimate(100 * share.value, low, high))


def _kind(sign: int) -> str:
    return "Classical" if sign > 0 else "Learned"


def rule_of_choice(verdicts: Sequence[TaskVerdict], quick: bool) -> str:
    """Return how policies were chosen to represent their kinds, in a sentence."""
    if quick:
        return FIRST
    choices = (choice for verdict in verdicts for choice in (verdict.classical, verdict.learned))
    return CHOSEN_AT_FIRST if any(choice and choice.any_number for choice in choices) else CHOSEN


def chosen(choice: Choice | None) -> str:
    """Return the name of the chosen policy, in words."""
    return choice.policy if choice else "nobody"


def _times(policies: Sequence[PolicySummary]) -> str:
    """Return decision times, each with what it is unless all are the same."""
    times = [f"{policy.policy} {policy.decision_time}" for policy in policies]
    kinds = [policy.timing for policy in policies]
    if len(set(kinds)) == 1:
        return ", ".join(times) + (f" ({kinds[0]})" if kinds[0] else "")
    return ", ".join(f"{time} ({kind or 'latency'})" for time, kind in zip(times, kinds, strict=True))
