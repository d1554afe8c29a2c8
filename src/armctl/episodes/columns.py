"""The columns of an `EpisodeTable`: numbers in arrays, and of what comes again and again, one each."""

import math
from array import array
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

_TICKS = 1e4
"""In a ms: decision times are whole numbers of 0.1 us."""
_UNKNOWN = -1
"""In place of a decision time that is NaN."""


class Numbers:
    """A column of numbers of 8 bytes."""

    def __init__(self, kind: str) -> None:
        self._values: array[Any] = array(kind)
        self.append = self._values.append

    def extend(self, values: NDArray[Any]) -> None:
        """Add many at once."""
        self._values.frombytes(values.astype(self._values.typecode).tobytes())

    def __getitem__(self, row: int) -> Any:
        return self._values[row]

    def take(self, rows: Rows) -> NDArray[Any]:
        """The numbers in some rows."""
        return np.asarray(np.asarray(self._values)[rows])


class Repeated:
    """A column of values that come again and again, each of which is kept once."""

    def __init__(self) -> None:
        self._kept: list[Any] = []
        self._places: dict[Any, int] = {}
        self._codes = array("i")

    def append(self, value: Any) -> None:
        """Add a value."""
        self._codes.append(self._place(value))

    def extend(self, values: Sequence[Any], codes: NDArray[np.integer[Any]]) -> None:
        """Add `values[code]` for each of the codes."""
        places = np.array([self._place(value) for value in values], np.intc)
        self._codes.frombytes(places[codes].tobytes())

    def __getitem__(self, row: int) -> Any:
        return self._kept[self._codes[row]]

    def take(self, rows: Rows) -> NDArray[Any]:
        """The values in some rows; as objects, unless all of the column are integers or all truth values."""
        plain = set(map(type, self._kept)) in ({bool}, {int})
        kept = np.array(self._kept, dtype=None if plain else object)
        return np.asarray(kept[self.codes(rows)])

    def codes(self, rows: Rows) -> NDArray[np.intc]:
        """Equal numbers for equal values, in some rows."""
        return np.asarray(np.asarray(self._codes)[rows])

    def _place(self, value: Any) -> int:
        place = self._places.setdefault(value, len(self._kept))
        if place == len(self._kept):
            self._kept.append(value)
        return place


class Lists:
    """Lists of numbers, one after the other."""

    def __init__(self, kind: str) -> None:
        self._flat: array[Any] = array(kind)
        self._ends = array("q", [0])

    def append(self, values: Iterable[float]) -> None:
        """Add a list."""
        self._flat.extend(values)
        self._ends.append(len(self._flat))

    def extend(self, flat: NDArray[Any], lengths: NDArray[np.integer[Any]]) -> None:
        """Add many lists, of these lengths, at once."""
        self._ends.frombytes((self._ends[-1] + np.cumsum(lengths, dtype=np.int64)).tobytes())
        self._flat.frombytes(flat.astype(self._flat.typecode).tobytes())

    def __len__(self) -> int:
        return len(self._ends) - 1

    def __getitem__(self, row: int) -> NDArray[Any]:
        return np.array(self._flat[self._ends[row] : self._ends[row + 1]])

    def take(self, rows: Rows) -> tuple[NDArray[Any], NDArray[np.int64]]:
        """The lists in some rows, one after the other, and the length of each."""
        ends = np.asarray(self._ends)
        starts, lengths = ends[rows], ends[rows + 1] - ends[rows]
        shifts = starts - (np.cumsum(lengths) - lengths)
        return np.asarray(self._flat)[np.repeat(shifts, lengths) + np.arange(lengths.sum())], lengths


class Times:
    """Decision times, ms: as whole numbers of 0.1 us, but for episodes with others."""

    def __init__(self) -> None:
        self._ticks = Lists("i")
        self._others: dict[int, Array] = {}

    def append(self, decision_ms: Array) -> None:
        """Add those of an episode."""
        self.extend(decision_ms, np.array([len(decision_ms)]))

    def extend(self, decision_ms: Array, lengths: NDArray[np.integer[Any]]) -> None:
        """Add those of many episodes, one after the other, of these lengths."""
        unknown = np.isnan(decision_ms)
        ticks = np.where(unknown, _UNKNOWN, np.rint(decision_ms * _TICKS))
        if (((np.abs(ticks) < 2**31) & (_ms(ticks) == decision_ms)) | unknown).all():
            self._ticks.extend(ticks, lengths)
        elif len(lengths) == 1:
            self._others[len(self)] = np.array(decision_ms)
            self._ticks.append([])
        else:
            for times in np.split(decision_ms, np.cumsum(lengths)[:-1]):
                self.append(times)

    def __len__(self) -> int:
        return len(self._ticks)

    def __getitem__(self, row: int) -> Array:
        return self._others[row] if row in self._others else _ms(self._ticks[row])

    def take(self, rows: Rows) -> tuple[Array, NDArray[np.int64]]:
        """Those in some rows, one after the other, and how many there are in each."""
        if self._others:
            lists = [self[row] for row in rows.tolist()]
            return np.concatenate([np.empty(0), *lists]), np.array(list(map(len, lists)), np.int64)
        ticks, lengths = self._ticks.take(rows)
        return _ms(ticks), lengths


def _ms(ticks: NDArray[Any]) -> Array:
    return np.where(ticks == _UNKNOWN, math.nan, ticks / _TICKS)
