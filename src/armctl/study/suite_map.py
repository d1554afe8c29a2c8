"""The map of a suite: which kind leads in each task and setting, and whether that is certain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from armctl.episodes.stored import UNDISTURBED
from armctl.stats.across_tasks import TaskPair
from armctl.stats.difference import MARGIN
from armctl.stats.intervals import FEWEST
from armctl.study.names import setting_name
from armctl.study.task_verdict import TaskVerdict
from armctl.verdict.tables import UNKNOWN, Cell, Column, Table

INITIALS = {"classical": "C", "learned": "L", "hybrid": "H"}
"""Kinds in tables."""
UNCERTAIN, EQUAL, EQUIVALENT = "?", "=", "~"
"""Marks of a lead that is not certain, of the same success, and of equivalence."""


@dataclass(frozen=True)
class KindLead:
    """The kind with the highest success in a setting, of the policies that represent the kinds."""

    kind: str
    """Empty if several have the same success."""
    points: float
    """Lead over the next kind in points of success."""
    certain: bool
    """True if it is significantly better than each other kind."""
    equivalent: bool
    """True if all differences are within the margin, with significance."""
    policies: Mapping[str, str]
    """The policy that represents each kind."""

    @property
    def text(self) -> str:
        """Initial of the kind, lead in points, and the mark."""
        if not self.kind:
            return EQUAL
        mark = "" if self.certain else f" {EQUIVALENT if self.equivalent else UNCERTAIN}"
        return f"{INITIALS[self.kind]} {self.points:+.0f}{mark}"


LEGEND = (
    "C, L, H: the best classical, learned or hybrid policy has the highest success, by so many points; in parentheses, "
    f"the number of the level. {UNCERTAIN}: not significantly better than each other kind, {EQUIVALENT}: equivalent "
    f"within {100 * MARGIN:g} points, {EQUAL}: the same success. Tests as for the verdicts: undisturbed after Holm's "
    "correction for all tasks, disturbed for all settings of the task."
)


def map_columns(levels: Sequence[Mapping[str, Sequence[float]]]) -> list[tuple[str, int]]:
    """Return the columns after the undisturbed one, from the levels of each task: a disturbance and one of its levels.

    Levels are numbered from 1 on.
    """
    counts: dict[str, int] = {}
    for of_task in levels:
        for name, at in of_task.items():
            counts[name] = max(counts.get(name, 0), len(at) - 1)
    return [(name, i) for name, count in counts.items() for i in range(1, count + 1)]


def setting_in_column(levels: Mapping[str, Sequence[float]], column: tuple[str, int]) -> tuple[str, float] | None:
    """Return the setting and level of a task in a column; None if it does not have that level."""
    name, i = column
    at = levels.get(name, ())
    return (setting_name(name, at[i]), at[i]) if i < len(at) else None


def kind_lead(verdict: TaskVerdict, setting: str) -> KindLead | None:
    """Return the kind that leads in a setting; None if kinds are not compared there."""
    pairs = _pairs(verdict, setting)
    if not pairs:
        return None
    kinds = list(dict.fromkeys(kind for two in pairs for kind in two))

    def leads(kind: str) -> list[float]:
        return [pair.difference.value * (1 if kind == a else -1) for (a, b), pair in pairs.items() if kind in (a, b)]

    first = max(kinds, key=lambda kind: sum(leads(kind)))
    own_pairs = {two: pair for two, pair in pairs.items() if first in two}
    certain = all(pair.better == (1 if two[0] == first else -1) for two, pair in own_pairs.items())
    smallest = min(leads(first))
    return KindLead(
        first if smallest > 0 or certain else "",
        100 * smallest,
        certain,
        all(pair.episodes >= FEWEST and pair.equivalent(MARGIN) for pair in pairs.values()),
        {kind: name for kind, name in represented(verdict).items() if kind in kinds},
    )


def _pairs(verdict: TaskVerdict, setting: str) -> dict[tuple[str, str], TaskPair]:
    """Return the pair of each two kinds that are compared in a setting."""
    by_kinds = {("classical", "learned"): verdict.pairs} | {
        ("hybrid", rival): pairs for rival, pairs in verdict.hybrid_pairs.items()
    }
    return {kinds: pairs[setting] for kinds, pairs in by_kinds.items() if setting in pairs}


def represented(verdict: TaskVerdict) -> dict[str, str]:
    """Return the policy that represents each kind."""
    choices = {"classical": verdict.classical, "learned": verdict.learned, "hybrid": verdict.hybrid}
    return {kind: choice.policy for kind, choice in choices.items() if choice}


def lead_table(verdicts: Sequence[TaskVerdict], levels: Mapping[str, Mapping[str, Sequence[float]]]) -> Table:
    """Return the map as a table, with a row for each task; `levels` are those of each environment's disturbances."""
    columns = map_columns(list(levels.values()))
    rows, records = [], []
    for verdict in verdicts:
        cells = [Cell(verdict.task)]
        for column in (None, *columns):
            at = (UNDISTURBED, 0.0) if column is None else setting_in_column(levels[verdict.env], column)
            lead = kind_lead(verdict, at[0]) if at else None
            cells.append(Cell(lead.text if lead else UNKNOWN))
            if lead and at:
                about = {"kind": lead.kind, "points": lead.points, "certain": lead.certain}
                records.append({"env": verdict.env, "setting": at[0], **about, "equivalent": lead.equivalent})
        rows.append(cells)
    headings = [Column("task"), Column("none"), *(Column(f"{name} ({i})", optional=True) for name, i in columns)]
    return Table("leads", "Which kind leads", headings, rows, records, LEGEND)
