"""The suite's answer for each task: classical or learned, by how much, at what cost, and where the order turns."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd

from armctl.core.registration import bare_id
from armctl.episodes.stored import UNDISTURBED
from armctl.policies import privileges
from armctl.runtime.provenance import looks_in_words
from armctl.stats.across_tasks import Choice, TaskPair, choose, pairwise_by_task, rate_of, values_of
from armctl.stats.intervals import FEWEST, Estimate, bounded_difference
from armctl.stats.paired import MARGIN, holm
from armctl.study.comparison import Comparison
from armctl.study.levels import setting_name
from armctl.study.task_results import Sweep
from armctl.verdict.scores import counted_rows
from armctl.verdict.summary import PolicySummary
from armctl.verdict.tables import p_value, points, size

CHOSEN = (
    "Where a kind has several policies, every third episode undisturbed chooses the best of them, and only the other "
    "episodes judge it."
)
"""What `armctl.stats.across_tasks.choose` does, as tables and pages say it."""


@dataclass(frozen=True)
class Answer:
    """What is known of one task."""

    env: str
    policies: Sequence[PolicySummary]
    """Undisturbed; empty if no episode was finished."""
    cells: dict[str, pd.DataFrame]
    """Success by setting, as `armctl.stats.across_tasks` takes it; empty if success is unknown."""
    labels: dict[str, str]
    """What settings are called: `noise 0.02`."""
    classical: Choice | None = None
    """Who stands for the best classical policy; None without any."""
    learned: Choice | None = None
    heads: dict[str, TaskPair] = field(default_factory=dict)
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
        return self.heads.get(UNDISTURBED)

    @property
    def contenders(self) -> list[str]:
        """The policies that stand for the two kinds."""
        return [choice.policy for choice in (self.classical, self.learned) if choice]

    @property
    def shared_cells(self) -> dict[str, pd.DataFrame]:
        """The cells of settings that reach all policies which stand for the two kinds."""
        ours = set(self.contenders)
        return {name: table for name, table in self.cells.items() if ours.isdisjoint(self.spared.get(name, ()))}

    def rate(self, choice: Choice | None) -> Estimate | None:
        """The undisturbed success rate of a choice, in the episodes that judge it."""
        return rate_of(self.cells[UNDISTURBED], choice) if choice and self.cells else None

    @property
    def verdict(self) -> str:
        """Which kind is better without disturbance, by how much: in success, and if neither is, in steps."""
        found = self.undisturbed
        if found is None:
            return _nothing(self)
        names = f"{chosen(self.classical)} against {chosen(self.learned)}"
        difference = points(found.difference)
        if found.episodes < FEWEST:
            return (
                f"No verdict from {found.episodes} episode{'s' * (found.episodes > 1)}: {names}, success {difference}"
            )
        if found.better:
            said = [f"{_kind(found.better)} is better: {names}, success {difference}, p = {p_value(found.p)}"]
        elif found.equivalent(MARGIN):
            said = [f"Equivalent in success within {100 * MARGIN:g} points: {names}, {difference}"]
        else:
            said = [f"Undecided: {names}, success {difference}, p = {p_value(found.p)}"]
        if found.faster and found.steps:
            kind = _kind(found.faster).lower()
            said.append(f"{kind} takes {size(found.steps)} steps fewer, p = {p_value(found.steps_p)}")
        if self.looks:
            said.append(looks_in_words(self.looks))
        return "; ".join(said)

    @property
    def turns(self) -> str:
        """Under which disturbances the order turns, and under which others the difference in success changes.

        Both only where the change itself is significant, after Holm's correction for all disturbed settings: that one
        difference is significant and another one is not shows no change. The order turns where the other kind is
        significantly better then. Empty if nothing was disturbed, or after too few undisturbed episodes for a verdict.
        """
        before = self.undisturbed
        disturbed = {name: one for name, one in self.heads.items() if name != UNDISTURBED}
        if before is None or before.episodes < FEWEST or not disturbed:
            return ""
        said, rest = [], dict(disturbed)
        for sign in (1, -1):
            turned = {name: one for name, one in rest.items() if one.changed == one.better == sign == -before.better}
            if turned:
                where = [f"{self.labels[name]} ({points(one.difference)})" for name, one in turned.items()]
                said.append(f"the order turns: {_kind(sign).lower()} is better with {', '.join(where)}")
            rest = {name: one for name, one in rest.items() if name not in turned}
        for sign in (1, -1):
            lost = {name: one for name, one in rest.items() if one.changed == sign}
            where = [
                f"{self.labels[name]} (by {size(_in_points(one.change))} points)"
                for name, one in lost.items()
                if one.change
            ]
            said += [f"the difference shifts towards {_kind(sign).lower()} with {', '.join(where)}"] if where else []
            rest = {name: one for name, one in rest.items() if name not in lost}
        if rest:
            others = "other " * bool(said)
            every = f"{'the' if said else 'any of the'} {len(rest)} {others}disturbed settings"
            said.append(f"not shown to change in {every if len(rest) > 1 else f'the {others}disturbed setting'}")
        return "; ".join(said)

    @property
    def not_compared(self) -> str:
        """Which settings spare a policy that stands for its kind; empty if none does."""
        shared, ours = self.shared_cells, set(self.contenders)
        said = [
            f"{self.labels[name]} (spares {', '.join(sorted(ours & self.spared[name]))})"
            for name in self.cells
            if name not in shared
        ]
        return f"Not compared: {', '.join(said)}." if said else ""

    @property
    def costs(self) -> str:
        """Training, decision times and privileges of those who stand for the two kinds."""
        by_name = {policy.policy: policy for policy in self.policies}
        ours = [by_name[name] for name in self.contenders]
        said = [words for policy in ours for words in policy.effort]
        said.append(f"a decision takes {_times(ours)}")
        return " ".join(filter(None, ("; ".join(said) + ".", privileges({one.policy: one.sees for one in ours}))))

    @property
    def sentence(self) -> str:
        """All of it."""
        if self.undisturbed is None:
            return f"{self.task}: {self.verdict}."
        turns = f"{self.turns[:1].upper()}{self.turns[1:]}." if self.turns else ""
        return " ".join(filter(None, (f"{self.task}: {self.verdict}.", turns, self.not_compared, self.costs)))


def answer(swept: Sweep) -> Answer:
    """The answer for the task of a sweep."""
    tables = {name: table for name, one in swept.comparisons.items() if (table := success_table(one)) is not None}
    named = {
        setting_name(name, level): f"{name} {level:g}" for name, levels in swept.levels.items() for level in levels
    }
    labels = {name: named.get(name, name) for name in swept.comparisons} | {UNDISTURBED: "undisturbed"}
    spared = {name: {one.policy for one in at.policies if one.spared} for name, at in swept.comparisons.items()}
    plain = swept.undisturbed
    if plain is None or UNDISTURBED not in tables:
        return Answer(swept.env, plain.policies if plain else [], {}, labels)
    played = counted_rows(plain.episodes)
    returns = played.pivot(index="episode", columns="policy", values="return").reindex(tables[UNDISTURBED].index)
    kinds: list[Choice | None] = []
    for learned in (False, True):
        names = [one.policy for one in plain.policies if one.learned == learned]
        kinds.append(choose(tables[UNDISTURBED], returns, names) if names else None)
    classical, trained = kinds
    found = Answer(swept.env, plain.policies, tables, labels, classical, trained, {}, swept.looks, spared)
    heads = pairwise_by_task(found.shared_cells, UNDISTURBED, classical, trained) if classical and trained else {}
    if UNDISTURBED in heads:
        heads[UNDISTURBED] = _with_steps(heads[UNDISTURBED], plain, classical, trained)
    return replace(found, heads=heads)


def _with_steps(head: TaskPair, plain: Comparison, classical: Choice | None, learned: Choice | None) -> TaskPair:
    """The same with the difference in steps to the goal, a failure counting as the time limit, if that is known."""
    if plain.facts.time_limit is None or classical is None or learned is None:
        return head
    rows = counted_rows(plain.episodes)
    rows = rows.assign(steps=rows.length.where(rows.success.astype(bool), plain.facts.time_limit))
    table = rows.pivot(index="episode", columns="policy", values="steps").astype(float)
    gains = np.asarray((values_of(table, classical) - values_of(table, learned)).dropna(), dtype=np.float64)
    found = bounded_difference(gains, (1.0 - plain.facts.time_limit, plain.facts.time_limit - 1.0))
    return replace(head, steps=found.estimate, steps_p=found.p) if found else head


def corrected(answers: Sequence[Answer]) -> list[Answer]:
    """The same answers, the undisturbed tests corrected for all tasks: p-values by Holm, equivalence by Bonferroni.

    The tests of success and of steps are corrected together, as either may be told.
    """
    heads = {one.env: head for one in answers if (head := one.undisturbed)}
    tests = {(env, name): p for env, head in heads.items() for name in ("p", "steps_p")
             if (p := getattr(head, name)) is not None}  # fmt: skip
    adjusted = dict(zip(tests, holm(list(tests.values())), strict=True))
    told = {
        env: replace(head, p=adjusted[env, "p"], steps_p=adjusted.get((env, "steps_p")), num_comparisons=len(heads))
        for env, head in heads.items()
    }
    return [
        replace(one, heads={**one.heads, UNDISTURBED: told[one.env]}) if one.env in told else one for one in answers
    ]


def success_table(comparison: Comparison) -> pd.DataFrame | None:
    """Success by episode and policy; None if it is unknown. Which episodes count is as in `counted_results`.

    Policies that the disturbance does not reach are left out.
    """
    played = comparison.episodes
    if not len(played) or not comparison.policies or played.success.isna().any():
        return None
    won = counted_rows(played).pivot(index="episode", columns="policy", values="success").astype(float)
    return won.reindex(columns=[one.policy for one in comparison.policies if not one.spared])


def _in_points(share: Estimate) -> Estimate:
    low, high = (100 * bound for bound in share.bounds)
    return Estimate(100 * share.value, low, high)


def _kind(sign: int) -> str:
    return "Classical" if sign > 0 else "Learned"


def chosen(choice: Choice | None) -> str:
    """Who stands for a kind, in words."""
    return choice.policy if choice else "nobody"


def _nothing(found: Answer) -> str:
    if not found.policies:
        return "no episode was finished undisturbed"
    if not found.cells:
        return "the environment does not say what a success is"
    kind = "learned" if found.learned is None else "classical"
    return f"no {kind} policy has played"


def _times(policies: Sequence[PolicySummary]) -> str:
    """How long each decides; what these times are stands behind each, or once at the end if it is the same for all."""
    times = [f"{one.policy} {one.decision_ms_mean:.2g} ms" for one in policies]
    kinds = [one.timing for one in policies]
    if len(set(kinds)) == 1:
        return ", ".join(times) + (f" ({kinds[0]})" if kinds[0] else "")
    return ", ".join(f"{time} ({kind or 'latency'})" for time, kind in zip(times, kinds, strict=True))
