"""The result of a search for worst cases: a row for each policy."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from armctl.core.registration import bare_id
from armctl.episodes.record import EpisodeResult
from armctl.stats.failure_line import failure_distance
from armctl.stats.failure_surface import ROUND_WIDTHS
from armctl.stats.intervals import Estimate
from armctl.study.axis import Axis
from armctl.study.comparison import Comparison
from armctl.verdict.notebook import Displayed
from armctl.verdict.summary import PolicySummary
from armctl.verdict.tables import Cell, Column, Document, Remark, Table, percent


@dataclass(frozen=True)
class JudgedPoint:
    """New episodes of a policy at a point on the line through the result of its search."""

    levels: Mapping[str, float]
    """Levels of the disturbances, without those that have no effect."""
    distance: float
    """Euclidean norm of the levels, in units of their ranges."""
    comparison: Comparison

    @property
    def summary(self) -> PolicySummary:
        """Summary of the episodes."""
        return self.comparison.policies[0]


@dataclass(frozen=True)
class Case:
    """The mildest disturbance with which a policy fails half of the time, by its search, and the judgement on it."""

    policy: str
    levels: Mapping[str, float]
    """Levels of the search's point; the ends of all ranges if none was mild enough."""
    searched: int
    """Number of episodes of the search."""
    spared: Sequence[str]
    """Disturbances that do not reach the policy."""
    line: Sequence[JudgedPoint]
    """Points on the line through these levels, the mildest one first."""

    @property
    def at_levels(self) -> JudgedPoint:
        """The point of the search."""
        return next(point for point in self.line if point.levels == self.levels)

    @property
    def summary(self) -> PolicySummary:
        """Summary of the new episodes at the search's point."""
        return self.at_levels.summary

    @property
    def comparison(self) -> Comparison:
        """The new episodes at the search's point."""
        return self.at_levels.comparison

    @cached_property
    def distance(self) -> Estimate:
        """Distance at which success falls to one half along the line, infinite if it does not."""
        success = [point.comparison.counted[self.policy].column("success") for point in self.line]
        return failure_distance(
            [point.distance for point in self.line],
            [np.nansum(of_point) for of_point in success],
            [np.isfinite(of_point).sum() for of_point in success],
        )

    @property
    def distance_in_words(self) -> str:
        """The distance, or the largest one that was judged."""
        value = self.distance.value
        return f"{value:.2f}" if np.isfinite(value) else f"> {self.line[-1].distance:.2f}"

    @property
    def interval_in_words(self) -> str:
        """The interval of the distance; without failures, it has no upper limit."""
        low, high = self.distance.bounds
        return f"{low:.2f} to {high:.2f}" if np.isfinite(high) else f"from {low:.2f}"

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
                    "policy": case.policy, "kind": case.summary.side, "distance": case.distance.value,
                    "distance_low": case.distance.low, "distance_high": case.distance.high,
                    **{axis.name: case.levels.get(axis.name, axis.neutral) for axis in self.axes},
                    "searched": case.searched, "episodes": case.summary.episodes, "success": success.value,
                    "success_low": success.low, "success_high": success.high,
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
            Column("disturbance of the search"),
            Column("success there"),
        ]
        rows = [
            [
                Cell(case.policy), Cell(case.distance_in_words, case.interval_in_words),
                Cell(case.levels_in_words), percent(case.summary.success),
            ]
            for case in self.cases
        ]  # fmt: skip
        caption = (
            "Distance of the mildest disturbance with which a policy fails half of the time: Euclidean norm of its "
            f"levels in units of their ranges ({self.box}). Searched in {self.budget} episodes of each policy, of "
            f"seeds {self.seeds[0]} to {self.seeds[1]}, by a response surface. The distance is where success falls to "
            f"one half along the line through the search's disturbance, in new episodes, of seed {self.judge_seed}, "
            "with a 95 % interval that assumes only that no stronger disturbance helps; off the line, a milder failure "
            "may exist. Success: Clopper and Pearson's 95 % interval."
        )
        title = f"Worst cases in {bare_id(self.env)}"
        return Table("worst_cases", title, columns, rows, self.records, caption)

    def __repr__(self) -> str:
        cases = "; ".join(f"{case.policy} {case.distance_in_words}" for case in self.cases) or "none yet"
        return f"<Worst cases in {self.env} of {len(ROUND_WIDTHS)} rounds: {cases}>"
