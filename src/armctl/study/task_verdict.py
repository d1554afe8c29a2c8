"""Verdict on a task: classical, learned or hybrid, by how much, at what cost, and under which disturbances."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from armctl.core.kinds import KINDS, Kind
from armctl.core.registration import bare_id
from armctl.episodes.stored import UNDISTURBED
from armctl.policies import interfaces_in_words, isolation, privileges
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
from armctl.study.comparison import Comparison
from armctl.study.contenders import contenders, success_table
from armctl.study.task_results import Sweep
from armctl.verdict.summary import PolicySummary
from armctl.verdict.tables import p_value, points, size

if TYPE_CHECKING:
    import pandas as pd

FIRST = "The first expert and the first agent of each task's line-up, which no result selected."
"""Policies of a quick suite, as tables and pages state them."""
CHOSEN = (
    "The best policy of each kind: classical, learned and hybrid. If a kind has several, every third undisturbed "
    "episode selects the best of them, and only the others evaluate it: so the choice does not bias the verdict."
)
"""Rule of `armctl.stats.across_tasks.choose`, as tables and pages state it."""
CHOSEN_AT_FIRST = (
    f"The best policy of each kind: classical, learned and hybrid. If a kind has several, the first {SELECTING} "
    "undisturbed episodes select the best, and only later ones evaluate it: so the choice does not bias the verdict."
)
"""The same, where cells stop when they are decided."""

RESULTS = {1: "better", 0: "not shown to be better or worse", -1: "worse"}
"""Signs of `TaskPair.better`, of its first policy in words."""


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
    hybrid: Choice | None = None
    """Choice of the best hybrid; None without any."""
    hybrid_pairs: dict[Kind, dict[str, TaskPair]] = field(default_factory=dict)
    """The hybrid against the classical and against the learned choice, by the rival's kind, and by setting."""

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
        """Policies that represent the kinds."""
        return [choice.policy for choice in (self.classical, self.learned, self.hybrid) if choice]

    @property
    def shared_cells(self) -> "dict[str, pd.DataFrame]":
        """Cells of the settings that reach both the classical and the learned one."""
        return self.cells_of(self.classical, self.learned)

    def cells_of(self, *choices: Choice | None) -> "dict[str, pd.DataFrame]":
        """Return the cells of the settings that reach all these choices."""
        names = {choice.policy for choice in choices if choice}
        return {name: table for name, table in self.cells.items() if names.isdisjoint(self.spared.get(name, ()))}

    def rate(self, choice: Choice | None) -> Estimate | None:
        """Return the undisturbed success rate of a choice, in the episodes that judge it."""
        return rate_of(self.cells[UNDISTURBED], choice) if choice and self.cells else None

    @property
    def verdict(self) -> str:
        """Sentence on the better kind without disturbance: by success, and if neither is better, by steps."""
        pair = self.undisturbed
        if pair is None:
            return self.reason_for_no_pair
        names = f"{chosen(self.classical)} against {chosen(self.learned)}"
        difference = points(pair.difference)
        if pair.episodes < FEWEST:
            return f"No verdict from {pair.episodes} episode{'s' * (pair.episodes > 1)}: {names}, success {difference}"
        margin = f"{100 * MARGIN:g} points"
        if pair.better:
            but = f", but by less than {margin}" if pair.equivalent(MARGIN) else ""
            parts = [
                f"{kind_in_words(pair.better)} is better{but}: {names}, success {difference}, p = {p_value(pair.p)}"
            ]
        elif pair.equivalent(MARGIN):
            tests = "" if within(pair.difference, MARGIN) else " (two one-sided tests at 5 %)"
            parts = [f"Equivalent in success within {margin}{tests}: {names}, {difference}"]
        else:
            parts = [f"Undecided: {names}, success {difference}, p = {p_value(pair.p)}"]
        if pair.faster and pair.steps:
            kind = kind_in_words(pair.faster).lower()
            parts.append(f"{kind} takes {size(pair.steps)} fewer steps, p = {p_value(pair.steps_p)}")
        parts += ["on different episodes"] * (pair.wins is not None)
        if pair.anytime is not None:
            parts.append(f"after {pair.episodes:,} episodes, by a test that holds at any number of them")
        if self.looks:
            parts.append(looks_in_words(self.looks))
        return "; ".join(parts)

    @property
    def reason_for_no_pair(self) -> str:
        """Reason why there is no verdict."""
        if not self.policies:
            return "no episode was finished undisturbed"
        if not self.cells:
            return "the environment does not say what a success is"
        if self.classical and self.learned:
            return f"the first {SELECTING} undisturbed episodes select the best policies, and no later one was played"
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
                parts.append(f"the order reverses: {kind_in_words(sign).lower()} is better with {', '.join(settings)}")
            remaining = {name: pair for name, pair in remaining.items() if name not in reversed_order}
        for sign in (1, -1):
            shifted = {name: pair.change for name, pair in remaining.items() if pair.changed == sign and pair.change}
            settings = [f"{self.labels[name]} (by {_in_points(change)} points)" for name, change in shifted.items()]
            if settings:
                parts.append(f"the difference shifts towards {kind_in_words(sign).lower()} with {', '.join(settings)}")
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
        contenders = set(self.contenders)
        shared = self.cells_of(self.classical, self.learned, self.hybrid)
        settings = [
            f"{self.labels[name]} (spares {', '.join(sorted(contenders & self.spared[name]))})"
            for name in self.cells
            if name not in shared
        ]
        return f"Not compared: {', '.join(settings)}." if settings else ""

    @property
    def of_hybrid(self) -> str:
        """Sentences on the best hybrid against the best of each other kind; empty without any."""
        sentences = []
        for kind, pairs in self.hybrid_pairs.items():
            rival = chosen(self.classical if kind == "classical" else self.learned)
            results = [
                f"{RESULTS[pair.better]} {self.labels[name] if name == UNDISTURBED else f'with {self.labels[name]}'} "
                f"({points(pair.difference)}, p = {p_value(pair.p)})"
                for name, pair in pairs.items()
                if pair.better or name == UNDISTURBED
            ]
            sentences.append(f"Hybrid {chosen(self.hybrid)} against {kind} {rival}: {'; '.join(results)}.")
        return " ".join(sentences)

    @property
    def costs(self) -> str:
        """Training, decision times and privileges of the policies that represent the kinds."""
        by_name = {policy.policy: policy for policy in self.policies}
        contenders = [by_name[name] for name in self.contenders]
        parts = [words for policy in contenders for words in policy.effort]
        if not all(math.isnan(policy.decision_ms_p50) for policy in contenders):
            parts.append(f"median decision time: {_times(contenders)}")
        sees = privileges({policy.policy: policy.privilege for policy in contenders})
        commands = interfaces_in_words({policy.policy: policy.interface for policy in contenders})
        apart = isolation({policy.policy: policy.isolated for policy in self.policies})
        return " ".join(filter(None, ("; ".join(parts) + "." * bool(parts), sees, commands, apart)))

    @property
    def context(self) -> str:
        """Disturbances, hybrids and costs: what follows the verdict."""
        if not (self.undisturbed or self.hybrid_pairs):
            return ""
        reversals = f"{self.reversals[:1].upper()}{self.reversals[1:]}." if self.reversals else ""
        reversals = with_looks(reversals, self.looks)
        return " ".join(filter(None, (reversals, self.of_hybrid, self.not_compared, self.costs)))


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
    choices = contenders(plain, sweep.any_number)
    classical, trained, hybrid = (choices.get(kind) for kind in KINDS)
    verdict = TaskVerdict(
        sweep.env, plain.policies, tables, labels, classical, trained, {}, sweep.looks, spared, hybrid
    )
    num_pairs = math.comb(len(choices), 2)
    rivals: dict[Kind, Choice] = {kind: choice for kind, choice in choices.items() if kind != "hybrid"}
    hybrid_pairs = {
        kind: _pairs(verdict, sweep, plain, (hybrid, rival), num_pairs) for kind, rival in rivals.items() if hybrid
    }
    pairs = _pairs(verdict, sweep, plain, (classical, trained), num_pairs) if classical and trained else {}
    return replace(verdict, pairs=pairs, hybrid_pairs={kind: pairs for kind, pairs in hybrid_pairs.items() if pairs})


def _pairs(
    verdict: TaskVerdict, sweep: Sweep, plain: Comparison, choices: tuple[Choice, Choice], num_pairs: int
) -> dict[str, TaskPair]:
    """Return two choices against each other, by setting; undisturbed, with their difference in steps."""
    cells = verdict.cells_of(*choices)
    pairs = pairwise_by_task(cells, UNDISTURBED, *choices, paired=sweep.paired, num_pairs=num_pairs)
    if UNDISTURBED in pairs:
        pairs[UNDISTURBED] = _with_steps(pairs[UNDISTURBED], plain, *choices)
    return pairs


def _with_steps(pair: TaskPair, plain: Comparison, first: Choice, second: Choice) -> TaskPair:
    """Add the difference in steps to the goal, a failure counting as the time limit, if that is known."""
    time_limit = plain.facts.time_limit
    if time_limit is None:
        return pair
    rows = plain.counted_rows
    rows = rows.assign(steps=rows.length.where(rows.success.astype(bool), time_limit))
    table = rows.pivot(index="episode", columns="policy", values="steps").astype(float)
    steps = (1.0, float(time_limit))
    scores = values_of(table, first), values_of(table, second)
    result = mean_difference(*scores, steps, plain.facts.paired, first.any_number)
    return replace(pair, steps=result.estimate, steps_p=result.p) if result else pair


def holm_corrected(verdicts: Sequence[TaskVerdict]) -> list[TaskVerdict]:
    """Correct the undisturbed tests for all tasks and pairs of kinds: p-values by Holm, equivalence by Bonferroni.

    The tests of success and of steps are corrected together, as a verdict may state either.
    """
    undisturbed: dict[tuple[str, Kind | None], TaskPair]
    undisturbed = {(verdict.env, None): pair for verdict in verdicts if (pair := verdict.undisturbed)}
    for verdict in verdicts:
        rivals = verdict.hybrid_pairs.items()
        undisturbed |= {(verdict.env, kind): pairs[UNDISTURBED] for kind, pairs in rivals if UNDISTURBED in pairs}
    tests = {(*key, name): p for key, pair in undisturbed.items() for name in ("p", "steps_p")
             if (p := getattr(pair, name)) is not None}  # fmt: skip
    adjusted = dict(zip(tests, holm(list(tests.values())), strict=True))
    corrected = {
        key: replace(
            pair, p=adjusted[(*key, "p")], steps_p=adjusted.get((*key, "steps_p")), num_comparisons=len(undisturbed)
        )
        for key, pair in undisturbed.items()
    }

    def of(env: str, rival: Kind | None, pairs: dict[str, TaskPair]) -> dict[str, TaskPair]:
        return pairs | {UNDISTURBED: corrected[env, rival]} if (env, rival) in corrected else pairs

    return [
        replace(
            verdict,
            pairs=of(verdict.env, None, verdict.pairs),
            hybrid_pairs={kind: of(verdict.env, kind, pairs) for kind, pairs in verdict.hybrid_pairs.items()},
        )
        for verdict in verdicts
    ]


def _in_points(share: Estimate) -> str:
    low, high = (100 * bound for bound in share.bounds)
    return size(Estimate(100 * share.value, low, high))


def kind_in_words(sign: int) -> str:
    """Return the kind that a sign of a `TaskPair` stands for."""
    return "Classical" if sign > 0 else "Learned"


def rule_of_choice(verdicts: Sequence[TaskVerdict], quick: bool) -> str:
    """Return how policies were chosen to represent their kinds, in a sentence."""
    if quick:
        return FIRST
    choices = (choice for verdict in verdicts for choice in (verdict.classical, verdict.learned, verdict.hybrid))
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
