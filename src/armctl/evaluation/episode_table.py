"""Many episodes in little memory: a million should fit, and an `EpisodeResult` each takes some 1,500 bytes.

A table takes 220 bytes an episode, and 4 for each decision. Numbers are kept by column; of names, and of small numbers
that come again and again, one each is kept.
"""

import json
import math
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from typing import Any, get_type_hints, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from armctl.evaluation.metrics import Metrics, warm_times
from armctl.evaluation.record import COLUMNS, EpisodeResult

Array = NDArray[np.float64]

_APART = ("reward_terms", "metrics", "decision_ms")
_PLAIN = [one.name for one in fields(EpisodeResult) if one.name not in _APART]
_METRICS = [one.name for one in fields(Metrics)]
_TYPES = get_type_hints(EpisodeResult) | get_type_hints(Metrics)
_TICKS = 1e4
"""In a ms: decision times are whole numbers of 0.1 us."""
_UNKNOWN = -1
"""In place of a decision time that is NaN."""


class EpisodeTable(Sequence[EpisodeResult]):
    """A sequence of episode results, each of which is made from the columns when it is asked for.

    Parts of a table share its columns: a slice, or what an array of indices or a mask (len(table),) picks.
    """

    def __init__(self, results: Iterable[EpisodeResult] = ()) -> None:
        self._columns: dict[str, _Column] = {name: _column(name) for name in (*_PLAIN, *_METRICS)}
        self._terms, self._earned, self._decision_ms = _Repeated(), _Lists("d"), _Times()
        self._rows: NDArray[np.intp] | None = None
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
        values = self._columns[name].values()
        return values if self._rows is None else values[self._rows]

    def with_column(self, name: str, values: Iterable[Any]) -> "EpisodeTable":
        """The same episodes with other values of a field."""
        changed = self._sharing(self._all_rows)
        column, new = _column(name), self._columns[name].values().astype(object)
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
    def won(self) -> NDArray[np.bool_]:
        """Whether each was a success; False where that is unknown."""
        return self.column("success").astype(bool)

    @property
    def optimality_gap(self) -> Array:
        """As `EpisodeResult.optimality_gap`, of each."""
        with np.errstate(divide="ignore"):
            return np.where(self.won, self.column("length") / self.column("least_length") - 1, math.nan)

    def earned(self) -> dict[str, Array]:
        """The sums of each reward term, by its name, in the episodes that have it."""
        rows, found = self._all_rows, dict[str, list[Array]]()
        values, starts, codes = np.asarray(self._earned.flat), self._earned.starts()[rows], self._terms.codes()[rows]
        order = np.argsort(codes, kind="stable")
        alike = np.split(order, np.flatnonzero(np.diff(codes[order])) + 1) if len(order) else []
        for those in sorted(alike, key=lambda those: int(those[0])):
            for i, name in enumerate(self._terms[rows[those[0]]]):
                found.setdefault(name, []).append(values[starts[those] + i])
        return {name: np.concatenate(parts) for name, parts in found.items()}

    def decision_seconds(self) -> Array:
        """(len(self),) the time of all decisions of each episode."""
        times = (self._decision_ms[row] for row in self._all_rows.tolist())
        return np.array([float(np.nansum(spent)) / 1e3 for spent in times])

    def warm_ms(self) -> Array:
        """The times of all warm decisions, of one episode after the other, in an array of its own."""
        cold = (~np.isnan(self.column("decision_ms_cold"))).tolist()
        found, end = np.empty(int(self.column("length").sum())), 0
        for row, first in zip(self._all_rows.tolist(), cold, strict=True):
            times = warm_times(self._decision_ms[row], first)
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
    def _all_rows(self) -> NDArray[np.intp]:
        return np.arange(len(self)) if self._rows is None else self._rows

    def _sharing(self, rows: NDArray[np.intp]) -> "EpisodeTable":
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


class _Numbers:
    """A column of numbers of 8 bytes."""

    def __init__(self, kind: str) -> None:
        self._values: array[Any] = array(kind)
        self.append = self._values.append

    def __getitem__(self, row: int) -> Any:
        return self._values[row]

    def values(self) -> NDArray[Any]:
        return np.array(self._values)


class _Repeated:
    """A column of values that come again and again, each of which is kept once."""

    def __init__(self) -> None:
        self._kept: list[Any] = []
        self._places: dict[Any, int] = {}
        self._codes = array("i")

    def append(self, value: Any) -> None:
        place = self._places.setdefault(value, len(self._kept))
        if place == len(self._kept):
            self._kept.append(value)
        self._codes.append(place)

    def __getitem__(self, row: int) -> Any:
        return self._kept[self._codes[row]]

    def values(self) -> NDArray[Any]:
        plain = set(map(type, self._kept)) in ({bool}, {int})
        kept = np.array(self._kept, dtype=None if plain else object)
        return np.asarray(kept[self.codes()])

    def codes(self) -> NDArray[np.intc]:
        """Equal numbers for equal values."""
        return np.array(self._codes)


_Column = _Numbers | _Repeated


def _column(name: str) -> _Column:
    if name == "episode":
        return _Numbers("q")
    return _Numbers("d") if _TYPES[name] is float else _Repeated()


class _Lists:
    """Lists of numbers, one after the other."""

    def __init__(self, kind: str) -> None:
        self.flat: array[Any] = array(kind)
        self._ends = array("q", [0])

    def append(self, values: Iterable[float]) -> None:
        self.flat.extend(values)
        self._ends.append(len(self.flat))

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __getitem__(self, row: int) -> NDArray[Any]:
        return np.array(self.flat[self._ends[row] : self._ends[row + 1]])

    def starts(self) -> NDArray[np.int64]:
        return np.array(self._ends)[:-1]


class _Times:
    """Decision times: as whole numbers of 0.1 us, but for episodes with others."""

    def __init__(self) -> None:
        self._ticks = _Lists("i")
        self._others: dict[int, Array] = {}

    def append(self, decision_ms: Array) -> None:
        ticks = np.rint(decision_ms * _TICKS)
        ticks[np.isnan(ticks)] = _UNKNOWN
        small = np.abs(ticks).max(initial=0) < 2**31
        if not small or not np.array_equal(self._ms(ticks), decision_ms, equal_nan=True):
            self._others[len(self)] = np.array(decision_ms)
            ticks = ticks[:0]
        self._ticks.append(array("i", ticks.astype(np.int32).tobytes()))

    def __len__(self) -> int:
        return len(self._ticks)

    def __getitem__(self, row: int) -> Array:
        return self._others[row] if row in self._others else self._ms(self._ticks[row])

    @staticmethod
    def _ms(ticks: NDArray[Any]) -> Array:
        return np.where(ticks == _UNKNOWN, math.nan, ticks / _TICKS)
