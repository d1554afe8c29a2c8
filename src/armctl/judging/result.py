"""The judgement of results made anywhere: a comparison of each task and condition, and of all together."""

import functools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from armctl.core.errors import ConfigurationError
from armctl.stats.correction import holm
from armctl.stats.difference import SIGNIFICANT, significant
from armctl.stats.intervals import FEWEST
from armctl.stats.robustness import GROUP
from armctl.study.comparison import Comparison
from armctl.verdict.notebook import Displayed
from armctl.verdict.pairs import Pair, verdict_pairs
from armctl.verdict.tables import UNKNOWN, Cell, Column, Document, Remark, Table, p_value, percent, plain, points

Outcome = Literal["better", "worse", "equivalent", "undecided"]


@dataclass(frozen=True)
class Conclusion:
    """Outcome of a policy against another one, the baseline if there is one."""

    policy: str
    against: str
    outcome: Outcome
    pair: Pair
    """The two as the verdict has them, the better one first."""

    def __str__(self) -> str:
        difference = self.pair.success
        episodes = f"{self.pair.difference.episodes} {'paired ' * self.pair.difference.paired}episodes"
        if difference is None:
            return f"{self.policy} against {self.against}, by return: {self.outcome} ({episodes})"
        signed = difference if self.pair.first.policy == self.policy else -difference
        by_name = {policy.policy: policy for policy in (self.pair.first, self.pair.second)}
        rates = [percent(by_name[name].success).text for name in (self.policy, self.against)]
        holm = f"p = {p_value(self.pair.p.success)}{f' ({words})' if (words := self.pair.interval_in_words) else ''}"
        return (
            f"{self.policy} {rates[0]} against {self.against} {rates[1]}: {self.outcome}, {points(signed)}, "
            f"{holm}, {episodes}"
        )


@dataclass(repr=False)
class Judgement(Displayed):
    """The verdict on results made anywhere."""

    cells: dict[str, Comparison]
    """A comparison for each task and condition."""
    overall: Comparison | None
    """All of them together, or the only one; None if policies have different numbers of episodes in them."""
    study: Sequence[Table | Remark] = ()
    """Tables and sentences of the sweep or the suite that the cells are."""
    played_study: Displayed | None = None
    """Sweep or suite that armctl played, whose tables are shown as they are."""

    @functools.cached_property
    def conclusions(self) -> list[Conclusion]:
        """Conclusions about each pair of the verdict: of all together, or else of each task, corrected."""
        if self.overall is not None:
            return _conclusions(self.overall)
        return [conclusion for cell in self.by_cell.values() for conclusion in cell]

    @functools.cached_property
    def by_cell(self) -> dict[str, list[Conclusion]]:
        """Conclusions in each task and condition, after Holm's correction for their number."""
        uncorrected = {name: _conclusions(comparison, len(self.cells)) for name, comparison in self.cells.items()}
        flat = [conclusion for cell in uncorrected.values() for conclusion in cell]
        firsts = [_p(conclusion.pair) for conclusion in flat]
        adjusted = iter(holm(firsts) if len(self.cells) > 1 and flat else firsts)
        return {
            name: [_weakened(conclusion, next(adjusted)) for conclusion in cell] for name, cell in uncorrected.items()
        }

    @functools.cached_property
    def not_compared(self) -> list[str]:
        """Tasks and conditions without a pair, or in which a policy has none with the baseline, and who played there.

        Policies that a disturbance does not affect need no pair.
        """
        everyone = {name.removesuffix(GROUP) for comparison in self.cells.values() for name in comparison.names}
        return [
            f"{cell} has {', '.join(_names(comparison)) or 'no policy'} only"
            for cell, comparison in self.cells.items()
            if (comparison.facts.baseline is not None and len(_names(comparison)) < len(everyone))
            or not (self.by_cell[cell] or any(policy.spared for policy in comparison.policies))
        ]

    def check_compared(self) -> None:
        """Raise `ConfigurationError` if no two policies were compared anywhere."""
        if not self.conclusions:
            raise ConfigurationError(f"nothing was compared: {'; '.join(self.not_compared) or 'there is no pair'}")

    def fails(self, outcomes: Collection[str]) -> bool:
        """Return True if any conclusion is one of these outcomes; `worse` also in a single task or condition.

        A pair that is missing is undecided. Raises `ConfigurationError` if all are.
        """
        self.check_compared()
        if any(conclusion.outcome in outcomes for conclusion in self.conclusions):
            return True
        if "undecided" in outcomes and self.not_compared:
            return True
        each = [conclusion.outcome for cell in self.by_cell.values() for conclusion in cell]
        return "worse" in outcomes and "worse" in each

    def document(self) -> Document:
        """Return the verdict and the tables of all together, and a table of the tasks and conditions."""
        if self.played_study is not None:
            return self.played_study.document()
        if self.overall is not None and len(self.cells) == 1:
            return self.overall.document()
        parts: list[Table | Remark] = []
        head: Mapping[str, Any] = {}
        if self.overall is not None:
            whole = self.overall.document()
            parts, head = [*whole.parts], whole.head
        else:
            counts = "; ".join(f"{name}: {_counts(comparison)}" for name, comparison in self.cells.items())
            parts.append(
                Remark(f"No verdict on all together, as the numbers of episodes differ ({counts}).", "verdict")
            )
            cells = self.cells.values()
            notes = dict.fromkeys(note for comparison in cells for note in (*comparison.doubts, *comparison.notes))
            parts += [Remark(note, "note") for note in notes]
        return Document([*parts, self._table(), *self.study], head)

    def _table(self) -> Table:
        """Return a table with a row for each task and condition."""
        names = list(dict.fromkeys(policy.policy for cell in self.cells.values() for policy in cell.policies))
        rows, records = [], []
        by_success = all(policy.success for cell in self.cells.values() for policy in cell.policies)
        for name, comparison in self.cells.items():
            by_name = {policy.policy: policy for policy in comparison.policies}
            rates = [
                Cell(UNKNOWN) if policy not in by_name
                else percent(by_name[policy].success) if by_success else plain(by_name[policy].episode_return)
                for policy in names
            ]  # fmt: skip
            ends = self.by_cell[name]
            first = ends[0].pair if ends else None
            difference = Cell(UNKNOWN)
            if first and first.success:
                difference = Cell(points(first.success), f"{first.first.policy} - {first.second.policy}")
            words = "; ".join(map(_in_words, ends)) or "no pair"
            rows.append([Cell(name), *rates, difference, Cell(words)])
            records.append({"cell": name, "conclusions": [asdict(end) for end in ends]})
        columns = [
            Column("task or condition"),
            *map(Column, names),
            Column("difference", optional=True),
            Column("verdict"),
        ]
        caption = (
            f"p after Holm's correction for {len(self.cells)} tasks and conditions; intervals: 95 %, each by itself."
        )
        return Table("cells", "Each task and condition", columns, rows, records, caption)

    def __repr__(self) -> str:
        return f"<Judgement: {'; '.join(map(str, self.conclusions)) or 'no pair'}>"


def _conclusions(comparison: Comparison, times: int = 1) -> list[Conclusion]:
    """Return the conclusions of a comparison, for so many times the number of pairs."""
    facts, names = comparison.facts, [policy.policy for policy in comparison.policies]
    if len(names) < 2 or facts.baseline not in (None, *names):
        return []
    pairs = verdict_pairs(comparison.policies, comparison.differences, facts.baseline)
    conclusions = [_conclusion(pair, facts.baseline, facts.margin, times) for pair in pairs]
    if min((pair.episodes for pair in comparison.differences), default=0) < FEWEST:
        conclusions = [replace(conclusion, outcome="undecided") for conclusion in conclusions]
    return conclusions


def _names(comparison: Comparison) -> list[str]:
    """Return the policies that have episodes; trainings that count as one have their policy's name."""
    return [policy.policy.removesuffix(GROUP) for policy in comparison.policies]


def _conclusion(pair: Pair, baseline: str | None, margin: float, times: int) -> Conclusion:
    is_baseline = pair.first.policy == baseline
    policy, against = (pair.second, pair.first) if is_baseline else (pair.first, pair.second)
    outcome: Outcome = "undecided"
    if _is_better(pair):
        outcome = "worse" if is_baseline else "better"
    elif pair.difference.equivalent(margin, pair.num_comparisons * times):
        outcome = "equivalent"
    return Conclusion(policy.policy, against.policy, outcome, pair)


def _is_better(pair: Pair) -> bool:
    """Return True if the first policy is significantly better: by success, or where that is unknown, by return."""
    if pair.p.success is not None:
        return pair.p.success < SIGNIFICANT
    if pair.p.returns is not None:
        return significant(pair.difference.simultaneous.returns, pair.p.returns)
    low, high = pair.difference.simultaneous.superiority.bounds
    return pair.p.higher < SIGNIFICANT and not low <= 0.5 <= high


def _p(pair: Pair) -> float:
    return next(p for p in (pair.p.success, pair.p.returns, pair.p.higher) if p is not None)


def _weakened(conclusion: Conclusion, p: float) -> Conclusion:
    """Return a conclusion that is undecided unless its corrected p-value is small."""
    if conclusion.outcome in ("better", "worse") and p >= SIGNIFICANT:
        return replace(conclusion, outcome="undecided")
    return conclusion


def _in_words(end: Conclusion) -> str:
    match end.outcome:
        case "better" | "worse":
            return f"{end.policy} is {end.outcome} than {end.against}"
    return end.outcome


def _counts(comparison: Comparison) -> str:
    return ", ".join(f"{policy.policy} {policy.episodes}" for policy in comparison.policies)
