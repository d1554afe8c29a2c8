"""The suite's answer for each task: classical or learned, by how much, at what cost, and where the order turns."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import pandas as pd

from armctl.evaluation.across_tasks import Choice, HeadToHead, choose, heads_to_head, rate_of
from armctl.evaluation.comparison import Comparison
from armctl.evaluation.paired import MARGIN, holm
from armctl.evaluation.scores import counted_rows
from armctl.evaluation.statistics import FEWEST, Estimate
from armctl.evaluation.summary import PolicySummary
from armctl.evaluation.sweep import UNDISTURBED, Sweep, folder_name
from armctl.evaluation.tables import points
from armctl.policies import privileges
from armctl.registration import bare_id

CHOSEN = (
    "As policies are chosen by the same episodes crosswise, a test at 5 % errs in up to 9 % of all cases where all are "
    "equally good (6 % at 50 episodes), and a 95 % interval holds in as few as 91 %."
)
"""What `armctl.evaluation.across_tasks.choose` costs, as tables and pages say it."""


@dataclass(frozen=True)
class Answer:
    """What is known of one task."""

    env: str
    policies: Sequence[PolicySummary]
    """Undisturbed; empty if no episode was finished."""
    cells: dict[str, pd.DataFrame]
    """Success by setting, as `armctl.evaluation.across_tasks` takes it; empty if success is unknown."""
    labels: dict[str, str]
    """What settings are called: `noise 0.02`."""
    classical: Choice | None = None
    """Who stands for the best classical policy; None without any."""
    learned: Choice | None = None
    heads: dict[str, HeadToHead] = field(default_factory=dict)
    """Classical against learned, by setting."""

    @property
    def task(self) -> str:
        """The task's name, as tables say it."""
        return bare_id(self.env)

    @property
    def undisturbed(self) -> HeadToHead | None:
        """Classical against learned without disturbance; None unless both have played."""
        return self.heads.get(UNDISTURBED)

    def rate(self, choice: Choice | None) -> Estimate | None:
        """The undisturbed success rate of a choice, each episode by the policy that stands for it there."""
        return rate_of(self.cells[UNDISTURBED], choice) if choice and self.cells else None

    @property
    def verdict(self) -> str:
        """Which kind is better without disturbance, by how much: in a few words."""
        found = self.undisturbed
        if found is None:
            return _nothing(self)
        names = f"{chosen(self.classical)} against {chosen(self.learned)}"
        difference = f"success {points(found.difference)}"
        if found.episodes < FEWEST:
            return f"No verdict from {found.episodes} episode{'s' * (found.episodes > 1)}: {names}, {difference}"
        if found.better:
            kind, p = ("Classical", "Learned")[found.better < 0], f"p = {found.p:.1g}"
            return f"{kind} is better: {names}, {difference}, {p}"
        if found.equivalent(MARGIN):
            return f"Equivalent within {100 * MARGIN:g} points: {names}, {difference}"
        return f"Undecided: {names}, {difference}"

    @property
    def turns(self) -> str:
        """Under which disturbances the order turns, or the lead is lost: significantly, after Holm's correction.

        Empty if nothing was disturbed, or after too few undisturbed episodes for a verdict.
        """
        before = self.undisturbed
        disturbed = {name: one for name, one in self.heads.items() if name != UNDISTURBED}
        if before is None or before.episodes < FEWEST or not disturbed:
            return ""
        said = []
        for better, words in ((1, "classical is better"), (-1, "learned is better")):
            where = [
                f"{self.labels[name]} ({points(one.difference)})"
                for name, one in disturbed.items()
                if one.better == better != before.better
            ]
            if where:
                turned = "the order turns: " if before.better else ""
                said.append(f"{turned}{words} with {', '.join(where)}")
        if before.better and (lost := [self.labels[name] for name, one in disturbed.items() if not one.better]):
            said.append(f"undecided with {', '.join(lost)}")
        if not said:
            every = f"all {len(disturbed)} disturbed settings" if len(disturbed) > 1 else "the disturbed setting"
            said.append(f"the order stays in {every}" if before.better else f"undecided in {every}")
        return "; ".join(said)

    @property
    def costs(self) -> str:
        """Training, decision times and privileges of those who stand for the two kinds."""
        by_name = {policy.policy: policy for policy in self.policies}
        ours = [by_name[name] for name in dict.fromkeys((*(self.classical or ()), *(self.learned or ())))]
        said = [f"{one.policy} was trained for {one.training}" for one in ours if one.learned]
        said.append(f"a decision takes {_times(ours)}")
        return " ".join(filter(None, ("; ".join(said) + ".", privileges({one.policy: one.sees for one in ours}))))

    @property
    def sentence(self) -> str:
        """All of it."""
        if self.undisturbed is None:
            return f"{self.task}: {self.verdict}."
        turns = f"{self.turns[:1].upper()}{self.turns[1:]}." if self.turns else ""
        return " ".join(filter(None, (f"{self.task}: {self.verdict}.", turns, self.costs)))


def answer(swept: Sweep) -> Answer:
    """The answer for the task of a sweep."""
    tables = {name: table for name, one in swept.comparisons.items() if (table := success_table(one)) is not None}
    named = {folder_name(name, level): f"{name} {level:g}" for name, levels in swept.levels.items() for level in levels}
    labels = {name: named.get(name, name) for name in swept.comparisons} | {UNDISTURBED: "undisturbed"}
    plain = swept.comparisons.get(UNDISTURBED)
    if plain is None or UNDISTURBED not in tables:
        return Answer(swept.env, plain.policies if plain else [], {}, labels)
    played = plain.episodes
    returns = played.pivot(index="episode", columns="policy", values="return").reindex(tables[UNDISTURBED].index)
    kinds: list[Choice | None] = []
    for learned in (False, True):
        names = [one.policy for one in plain.policies if one.learned == learned]
        kinds.append(choose(tables[UNDISTURBED], returns, names) if names else None)
    classical, trained = kinds
    heads = heads_to_head(tables, UNDISTURBED, classical, trained) if classical and trained else {}
    return Answer(swept.env, plain.policies, tables, labels, classical, trained, heads)


def corrected(answers: Sequence[Answer]) -> list[Answer]:
    """The same answers, the undisturbed tests corrected for all tasks: p-values by Holm, equivalence by Bonferroni."""
    heads = {one.env: head for one in answers if (head := one.undisturbed)}
    p_values = dict(zip(heads, holm([head.p for head in heads.values()]), strict=True))
    return [
        replace(one, heads={**one.heads, UNDISTURBED: replace(heads[one.env], p=p_values[one.env], claims=len(heads))})
        if one.env in heads
        else one
        for one in answers
    ]


def success_table(comparison: Comparison) -> pd.DataFrame | None:
    """Success by episode and policy; None if it is unknown. Which episodes count is as in `counted_results`."""
    played = comparison.episodes
    if not len(played) or not comparison.policies or played.success.isna().any():
        return None
    won = counted_rows(played).pivot(index="episode", columns="policy", values="success").astype(float)
    return won.reindex(columns=[one.policy for one in comparison.policies])


def chosen(choice: Choice | None) -> str:
    """Who stands for a kind, in words."""
    return " or ".join(dict.fromkeys(choice)) if choice else "nobody"


def _nothing(found: Answer) -> str:
    if not found.policies:
        return "no episode was finished undisturbed"
    if not found.cells:
        return "the environment does not say what a success is"
    kind = "learned" if found.learned is None else "classical"
    return f"no {kind} policy has played"


def _times(policies: Sequence[PolicySummary]) -> str:
    """How long each decides; what these times are stands behind each, or once at the end if it is the same for all."""
    times = [f"{one.policy} {one.decision_ms:.2g} ms" for one in policies]
    kinds = [one.timing for one in policies]
    if len(set(kinds)) == 1:
        return ", ".join(times) + (f" ({kinds[0]})" if kinds[0] else "")
    return ", ".join(f"{time} ({kind or 'latency'})" for time, kind in zip(times, kinds, strict=True))
