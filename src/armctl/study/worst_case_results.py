"""The result of a search for worst cases: a row for each policy."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from armctl.core.registration import bare_id
from armctl.episodes.record import EpisodeResult
from armctl.stats.failure_surface import ROUND_WIDTHS
from armctl.study.axis import Axis
from armctl.study.comparison import Comparison
from armctl.verdict.notebook import Displayed
from armctl.verdict.summary import PolicySummary
from armctl.verdict.tables import Cell, Column, Document, Remark, Table, percent

HALF = 0.5


@dataclass(frozen=True)
class Case:
    """The mildest disturbance with which a policy fails half of the time, by its search, and the judgement on it."""

    policy: str
    levels: Mapping[str, float]
    """Levels of the disturbances, without those that have no effect; the ends of all ranges if none was mild enough."""
    radius: float
    """Euclidean norm of the levels, in units of their ranges."""
    fails: bool
    """True if the search has a point of failure; else it says that the policy fails nowhere in the box."""
    searched: int
    """Number of episodes of the search."""
    spared: Sequence[str]
    """Disturbances that do not reach the policy."""
    summary: PolicySummary
    """Summary of the episodes that judge it."""
    comparison: Comparison

    @property
    def judgement(self) -> str:
        """Sentence on success in the new episodes."""
        assert self.summary.success is not None
        low, high = self.summary.success.bounds
        if not self.fails:
            if low > HALF:
                return "no failure in the box, as in the search"
            return "the search missed a failure in the box" if high < HALF else "undecided at the ends of all ranges"
        if low > HALF:
            return "not confirmed: it succeeds more than half of the time there"
        return (
            "fails more than half of the time: a milder one may do"
            if high < HALF
            else "fails in about half of the episodes"
        )

    @property
    def levels_in_words(self) -> str:
        """Levels as text."""
        return ", ".join(f"{name} {level:g}" for name, level in self.levels.items()) or "undisturbed"

    @cached_property
    def failure(self) -> EpisodeResult | None:
        """The failed episode with the median length among all failures; None without any."""
        table = self.comparison.counted.get(self.policy)
        if table is None:
            return None
        failures = table[table.column("success") == 0]
        if not len(failures):
            return None
        middle: EpisodeResult = failures[int(np.argsort(failures.column("length"), kind="stable")[len(failures) // 2])]
        return middle

    @property
    def replay(self) -> str:
        """Command that shows the failure; empty without any."""
        if self.failure is None:
            return ""
        comparison = self.comparison
        options = [f"--set {_quoted(f'{name}={value}')}" for name, value in comparison.env_options.items()]
        secret = f"--policy-seed {comparison.facts.policy_seed}"
        words = ("armctl view", shlex.quote(self.policy), "--env", shlex.quote(comparison.env), *options,
                 f"--seed {comparison.seed} --episode {self.failure.episode}", secret)  # fmt: skip
        return " ".join(words)


def _quoted(text: str) -> str:
    """Return a text as a word of a shell; one with quotes in it in double ones, if that is possible."""
    return f'"{text}"' if "'" in text and not set('"$`\\!') & set(text) else shlex.quote(text)


@dataclass(frozen=True, repr=False)
class WorstCases(Displayed):
    """The worst cases of all policies of a search, the most robust policy first."""

    env: str
    axes: Sequence[Axis]
    budget: int
    """Number of episodes of each search."""
    seeds: tuple[int, int]
    """First and last seed of the search."""
    judge_seed: int | None
    """Seed of the judgement; None before it."""
    cases: Sequence[Case]
    problems: Sequence[str]
    interrupted: bool

    @property
    def box(self) -> str:
        """Ranges as text."""
        return ", ".join(f"{axis.name} {axis.neutral:g} to {axis.end:g} ({axis.unit})" for axis in self.axes)

    @property
    def records(self) -> list[dict[str, Any]]:
        """Rows of `worst_case.csv`."""
        records = []
        for case in self.cases:
            success = case.summary.success
            assert success is not None
            records.append(
                {
                    "policy": case.policy, "kind": case.summary.side, "radius": case.radius,
                    "fails": case.fails,
                    **{axis.name: case.levels.get(axis.name, axis.neutral) for axis in self.axes},
                    "searched": case.searched, "episodes": case.summary.episodes, "success": success.value,
                    "low": success.low, "high": success.high, "judgement": case.judgement,
                    "spared": " ".join(case.spared),
                    "failed_episode": "" if case.failure is None else case.failure.episode,
                }
            )  # fmt: skip
        return records

    def document(self) -> Document:
        """Return a table with a row for each policy, and how to see a failure of each."""
        parts: list[Table | Remark] = []
        if self.cases:
            parts.append(self._table())
            parts += [
                Remark(f"{case.policy} fails in episode {case.failure.episode}: {case.replay}")
                for case in self.cases
                if case.failure is not None
            ]
            parts += [
                Remark(f"{case.policy}: not affected by {', '.join(case.spared)}.", "note")
                for case in self.cases
                if case.spared
            ]
        parts += [Remark(problem, "problem") for problem in self.problems]
        if self.interrupted:
            parts.append(Remark("Interrupted.", "note"))
        return Document(parts, {"env": self.env, "seeds": [*self.seeds], "judge_seed": self.judge_seed})

    def _table(self) -> Table:
        columns = [
            Column("policy"),
            Column("distance"),
            Column("success there"),
            Column("disturbance"),
            Column("judgement"),
        ]
        rows = [
            [
                Cell(case.policy), Cell(f"{'' if case.fails else '> '}{case.radius:.2f}"),
                percent(case.summary.success), Cell(case.levels_in_words), Cell(case.judgement),
            ]
            for case in self.cases
        ]  # fmt: skip
        caption = (
            "Distance of the mildest disturbance with which a policy fails half of the time: Euclidean norm of its "
            f"levels in units of their ranges ({self.box}). Searched in {self.budget} episodes of each policy, of "
            f"seeds {self.seeds[0]} to {self.seeds[1]}, by a response surface; success in new episodes, of seed "
            f"{self.judge_seed}, with Clopper and Pearson's 95 % interval."
        )
        title = f"Worst cases in {bare_id(self.env)}"
        return Table("worst_cases", title, columns, rows, self.records, caption)

    def __repr__(self) -> str:
        cases = "; ".join(f"{case.policy} {case.radius:.2f}: {case.judgement}" for case in self.cases) or "none yet"
        return f"<Worst cases in {self.env} of {len(ROUND_WIDTHS)} rounds: {cases}>"
