"""Many episodes in little memory: a million should fit, and an `EpisodeResult` each takes some 1,500 bytes.

A table takes 220 bytes an episode, and 4 for each decision. Numbers are kept by column; of names, and of small numbers
that come again and again, one each is kept.
"""

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any, get_type_hints, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from armctl.episodes.columns import Array, Lists, Numbers, Repeated, Rows, Times
from armctl.episodes.metrics import Metrics, warm_times
from armctl.episodes.record import COLUMNS, EpisodeResult

_APART = ("reward_terms", "metrics", "decision_ms")
_PLAIN = [one.name for one in fields(EpisodeResult) if one.name not in _APART]
_METRICS = [one.name for one in fields(Metrics)]
TYPES: dict[str, Any] = get_type_hints(EpisodeResult) | get_type_hints(Metrics)
"""Of the fields of results and their metrics."""
_AT_ONCE = 10_000
"""Episodes whose decision times are looked at together: more take memory, and fewer time."""


class EpisodeTable(Sequence[EpisodeResult]):
    """A sequence of episode results, each of which is made from the columns when it is asked for.

    Parts of a table share its columns: a slice, or what an array of indices or a mask (len(table),) picks.
    """

    def __init__(self, results: Iterable[EpisodeResult] = ()) -> None:
        self._columns: dict[str, Numbers | Repeated] = {name: _column(name) for name in (*_PLAIN, *_METRICS)}
        self._terms, self._earned, self._decision_ms = Repeated(), Lists("d"), Times()
        self._rows: Rows | None = None
        """The rows of the columns; None for all."""
        for result in results:
            self.append(result)

    def append(self, result: EpisodeResult) -> None:
        """Add an episode to a table that is not part of another one."""
        assert self._rows is None
        values = vars(result) | vars(result.metrics)
        for name, column in self._columns.items():
            column.append(values[name])
        self._terms.append(tuple(result.reward_terms))
        self._earned.append(result.reward_terms.values())
        self._decision_ms.append(result.decision_ms)

    def extend(
        self,
        numbers: Mapping[str, NDArray[Any]],
        repeated: Mapping[str, tuple[Sequence[Any], NDArray[np.integer[Any]]]],
        reward_terms: tuple[Sequence[tuple[str, ...]], Array],
        decision_ms: tuple[Array, NDArray[np.integer[Any]]],
    ) -> None:
        """Add many episodes to a table that is not part of another one, by column.

        Columns of numbers are arrays; others are values and, for each episode, the index of its own. Reward terms and
        decision times are as `reward_terms` and `decision_ms` return them.
        """
        assert self._rows is None
        for name, column in self._columns.items():
            column.extend(numbers[name]) if isinstance(column, Numbers) else column.extend(*repeated[name])
        names, earned = reward_terms
        for terms in names:
            self._terms.append(terms)
        self._earned.extend(earned, np.array(list(map(len, names))))
        self._decision_ms.extend(*decision_ms)

    def __len__(self) -> int:
        return len(self._decision_ms) if self._rows is None else len(self._rows)

    @overload
    def __getitem__(self, at: int) -> EpisodeResult: ...
    @overload
    def __getitem__(self, at: slice | NDArray[Any]) -> "EpisodeTable": ...
    def __getitem__(self, at: int | slice | NDArray[Any]) -> "EpisodeResult | EpisodeTable":
        if isinstance(at, int | np.integer):
            return self._result(int(self._all_rows[at]))
        return self._sharing(self._all_rows[at])

    def __iter__(self) -> Iterator[EpisodeResult]:
        return map(self._result, self._all_rows.tolist())

    def column(self, name: str) -> NDArray[Any]:
        """A field of the results or of their metrics, (len(self),); of objects if it is a text, or None in some."""
        return self._columns[name].take(self._all_rows)

    def with_column(self, name: str, values: Iterable[Any]) -> "EpisodeTable":
        """The same episodes with other values of a field."""
        changed = self._sharing(self._all_rows)
        all_rows = np.arange(len(self._decision_ms))
        column, new = _column(name), self._columns[name].take(all_rows).astype(object)
        new[self._all_rows] = list(values)
        for value in new.tolist():
            column.append(value)
        changed._columns = {**self._columns, name: column}
        return changed

    def together(self, other: "EpisodeTable") -> "EpisodeTable":
        """The episodes of this part of a table, and then those of another part of the same one."""
        assert self._decision_ms is other._decision_ms
        return self._sharing(np.concatenate((self._all_rows, other._all_rows)))

    def by_policy(self) -> dict[str, "EpisodeTable"]:
        """The episodes of each policy."""
        policies = self.column("policy")
        return {name: self[policies == name] for name in dict.fromkeys(policies.tolist())}

    def sorted(self, policies: Sequence[str]) -> "EpisodeTable":
        """The same, by policy in the given order, and then by episode."""
        places = {name: place for place, name in enumerate(policies)}
        order = np.array([places[name] for name in self.column("policy").tolist()])
        return self[np.lexsort((self.column("episode"), order))]

    @property
    def repeats(self) -> NDArray[np.bool_]:
        """Whether each is in an earlier row, too: the same episode of the same policy."""
        return pd.DataFrame({name: self.column(name) for name in ("policy", "episode")}).duplicated().to_numpy()

    @property
    def won(self) -> NDArray[np.bool_]:
        """Whether each was a success; False where that is unknown."""
        return self.column("success").astype(bool)

    @property
    def optimality_gap(self) -> Array:
        """As `EpisodeResult.optimality_gap`, of each."""
        least = np.where(self.column("least_length") > 0, self.column("least_length"), math.nan)
        with np.errstate(over="ignore"):
            return np.where(self.won, self.column("length") / least - 1, math.nan)

    def earned(self) -> dict[str, Array]:
        """The sums of each reward term, by its name, in the episodes that have it."""
        rows, found = self._all_rows, dict[str, list[Array]]()
        (values, lengths), codes = self._earned.take(rows), self._terms.codes(rows)
        starts = np.cumsum(lengths) - lengths
        order = np.argsort(codes, kind="stable")
        alike = np.split(order, np.flatnonzero(np.diff(codes[order])) + 1) if len(order) else []
        for those in sorted(alike, key=lambda those: int(those[0])):
            for i, name in enumerate(self._terms[rows[those[0]]]):
                found.setdefault(name, []).append(values[starts[those] + i])
        return {name: np.concatenate(parts) for name, parts in found.items()}

    def reward_terms(self) -> tuple[list[tuple[str, ...]], Array]:
        """The names of each episode's reward terms, and the sums of these, of one episode after the other."""
        rows = self._all_rows
        return [self._terms[row] for row in rows.tolist()], self._earned.take(rows)[0]

    def decision_ms(self) -> tuple[Array, NDArray[np.int64]]:
        """The decision times, of one episode after the other, and (len(self),) how many each has."""
        return self._decision_ms.take(self._all_rows)

    def decision_seconds(self) -> Array:
        """(len(self),) the time of the reset and of all decisions of each episode."""
        parts = [self[first : first + _AT_ONCE].decision_ms() for first in range(0, len(self), _AT_ONCE)]
        found = [
            np.bincount(np.repeat(np.arange(len(lengths)), lengths), np.nan_to_num(times, nan=0.0), len(lengths))
            for times, lengths in parts
        ]
        spent: Array = np.concatenate([np.empty(0), *found])
        spent += np.nan_to_num(self.column("reset_ms"), nan=0.0)
        return spent / 1e3

    def warm_ms(self) -> Array:
        """The times of all warm decisions, of one episode after the other, in an array of its own."""
        cold = ~np.isnan(self.column("decision_ms_cold"))
        (alone,) = np.nonzero(cold)
        bounds = np.unique(np.concatenate((alone, alone + 1, np.arange(0, len(self), _AT_ONCE), [len(self)])))
        found, end = np.empty(int(self.column("length").sum())), 0
        for first, last in itertools.pairwise(bounds.tolist()):
            times = warm_times(self[first:last].decision_ms()[0], bool(cold[first]))
            found[end : (end := end + len(times))] = times
        return found[:end]

    def frame(self) -> pd.DataFrame:
        """A row for each, with the columns of `episodes.csv`, as a DataFrame of `EpisodeResult.row` would have them."""
        if not len(self):
            return pd.DataFrame(columns=list(COLUMNS))
        values: dict[str, Any] = {}
        for name in COLUMNS:
            if name == "reward_terms":
                values[name] = pd.Series([json.dumps(self._reward_terms(row)) for row in self._all_rows.tolist()])
            elif name == "optimality_gap":
                values[name] = self.optimality_gap
            else:
                column = self.column("total_reward" if name == "return" else name)
                values[name] = pd.Series(column.tolist() if column.dtype == object else column)
        return pd.DataFrame(values)

    @property
    def _all_rows(self) -> Rows:
        return np.arange(len(self)) if self._rows is None else self._rows

    def _sharing(self, rows: Rows) -> "EpisodeTable":
        part = object.__new__(EpisodeTable)
        vars(part).update(vars(self), _rows=rows)
        return part

    def _reward_terms(self, row: int) -> dict[str, float]:
        return dict(zip(self._terms[row], self._earned[row].tolist(), strict=True))

    def _result(self, row: int) -> EpisodeResult:
        plain: dict[str, Any] = {name: self._columns[name][row] for name in _PLAIN}
        measured = Metrics(*(self._columns[name][row] for name in _METRICS))
        return EpisodeResult(
            **plain, reward_terms=self._reward_terms(row), metrics=measured, decision_ms=self._decision_ms[row]
        )


def table_of(results: Iterable[EpisodeResult]) -> EpisodeTable:
    """The results as a table, unless they are one."""
    return results if isinstance(results, EpisodeTable) else EpisodeTable(results)


def _column(name: str) -> Numbers | Repeated:
    if name == "episode":
        return Numbers("q")
    return Numbers("d") if TYPES[name] is float else Repeated()
