"""Columns of a table of episodes: numbers, lists of numbers, and values of which few are different.

Those of a large table are in a file without a name. Its pages are in memory only while they are read, so that a table
of any size leaves room for what is computed from it.
"""

import contextlib
import itertools
import mmap
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from armctl.core.arrays import Array

Rows = NDArray[np.intp]
LARGE = 2**25
"""Bytes from which on arrays are in a file."""
TICKS = 1e4
"""Number of ticks in 1 ms."""
UNKNOWN_TICKS = {"u2": 2**16 - 1, "i4": -1}
"""Number in place of NaN among whole ticks, by their type."""
NUM_COUNTED = 2**20
"""Times of up to so many ticks are counted, and longer ones kept: there are few, as they last 0.1 s."""


class Pages:
    """Memory for arrays of `size` bytes in all; without room for a file, they are in the process's memory."""

    def __init__(self, size: int = 0) -> None:
        self._file, self._end = None, 0
        if size >= LARGE:
            with contextlib.suppress(OSError), tempfile.TemporaryFile() as file:
                os.posix_fallocate(file.fileno(), 0, size)  # a full disk would kill who writes to the pages later
                self._file = mmap.mmap(file.fileno(), size)

    def array(self, size: int, kind: DTypeLike) -> NDArray[Any]:
        """Return an array (size,) of numbers; of no more bytes in all than were asked for."""
        if self._file is None or not size:
            return np.empty(size, kind)
        values = np.frombuffer(self._file, kind, size, self._end)
        self._end += -(-values.nbytes // 8) * 8
        return values

    def release(self) -> None:
        """Take the file's pages out of memory; arrays stay what they are."""
        if self._file is not None:
            self._file.madvise(mmap.MADV_DONTNEED)


class Column(NamedTuple):
    """A field of the results or of their metrics."""

    values: NDArray[Any]
    """(rows,) its values, or where these are among the different ones."""
    different: NDArray[Any] | None = None
    """The different values, if they are few."""

    def at(self, rows: Rows) -> NDArray[Any]:
        """Return the values in some rows."""
        values = self.values[rows]
        return values if self.different is None else self.different[values]


@dataclass(frozen=True)
class Ragged:
    """Lists of numbers, one after the other."""

    values: NDArray[Any]
    ends: NDArray[np.int64]
    """(lists + 1,) where each ends, after a 0."""

    @classmethod
    def of(cls, values: NDArray[Any], lengths: ArrayLike, pages: Pages | None = None) -> "Ragged":
        """Split values into lists of these lengths."""
        lengths = np.asarray(lengths, np.int64)
        ends = (pages or Pages()).array(len(lengths) + 1, np.int64)
        ends[0] = 0
        np.cumsum(lengths, out=ends[1:])
        return cls(values, ends)

    @property
    def lengths(self) -> NDArray[np.int64]:
        """(lists,) numbers in each list."""
        return np.diff(self.ends)

    def __getitem__(self, row: int) -> NDArray[Any]:
        return np.array(self.values[self.ends[row] : self.ends[row + 1]])

    def tolist(self) -> list[list[Any]]:
        """Return the lists."""
        values = self.values.tolist()
        return [values[start:end] for start, end in itertools.pairwise(self.ends.tolist())]

    def take(self, rows: Rows) -> "Ragged":
        """Return the lists in some rows."""
        starts, lengths = self.ends[rows], self.ends[rows + 1] - self.ends[rows]
        if len(rows) and (np.diff(rows) == 1).all():
            return Ragged.of(self.values[starts[0] : self.ends[rows[-1] + 1]], lengths)
        shifts = starts - (np.cumsum(lengths) - lengths)
        return Ragged.of(self.values[np.repeat(shifts, lengths) + np.arange(lengths.sum())], lengths)


def by_occurrence(codes: NDArray[np.intp], num_codes: int) -> tuple[Rows, NDArray[np.intp]]:
    """Return where each of the codes (k,) below `num_codes` first occurs, in this order, and (k,) its place in it."""
    if num_codes > len(codes):
        codes, num_codes = np.unique(codes, return_inverse=True)[1], len(codes)
    first = np.full(num_codes, len(codes))
    np.minimum.at(first, codes, np.arange(len(codes)))
    firsts = np.sort(first[first < len(codes)])
    places = np.empty(num_codes, np.intp)
    places[codes[firsts]] = np.arange(len(firsts))
    return firsts, places[codes]


def milliseconds(times: NDArray[Any]) -> Array:
    """Return decision times in ms, which are so already unless they are whole ticks."""
    if times.dtype.kind == "f":
        return np.array(times, float)
    spent = times / TICKS
    spent[is_unknown(times)] = np.nan
    return np.asarray(spent)


def is_unknown(times: NDArray[Any]) -> NDArray[np.bool_]:
    """Return where no decision began, in decision times in ms or in ticks."""
    if times.dtype.kind == "f":
        return np.asarray(np.isnan(times))
    return np.asarray(times == UNKNOWN_TICKS[times.dtype.str[1:]])


class TimeCounts:
    """Times of decisions as a set, in ms: exact quantiles of any number of times in little memory."""

    def __init__(self) -> None:
        self._counts = np.zeros(0, np.int64)
        self._rest: list[Array] = []
        """Times that are no ticks, or many of them."""

    def add(self, times: NDArray[Any]) -> None:
        """Add times (k,) in ms, or in ticks; all of one kind."""
        times = times[~is_unknown(times)]
        if times.dtype.kind != "f":
            is_long = times >= NUM_COUNTED
            counts = np.bincount(times[~is_long], minlength=len(self._counts))
            counts[: len(self._counts)] += self._counts
            self._counts, times = counts, times[is_long]
        if len(times):
            self._rest.append(milliseconds(times))

    def __len__(self) -> int:
        return int(self._counts.sum()) + sum(map(len, self._rest))

    def quantiles(self, shares: Sequence[float], at_least: float = 0.0) -> list[float]:
        """Return what `np.quantile` does for these shares of the times, shorter ones counting as `at_least`, ms.

        Without any times, quantiles are NaN.
        """
        ranks = [max(len(self) - 1, 0) * share for share in shares]
        ranked = self._ranked([rank for low in map(int, ranks) for rank in (low, low + 1)])
        pairs = zip(ranks, np.maximum(ranked, at_least).reshape(-1, 2), strict=True)
        return [float(np.quantile(pair, rank - int(rank))) for rank, pair in pairs]

    @property
    def median(self) -> float:
        """Return what `np.median` does, NaN without any times."""
        return float(np.mean(self._ranked([(len(self) - 1) // 2, len(self) // 2])))

    def _ranked(self, ranks: Sequence[int]) -> Array:
        """Return the times of some ranks, from 0, for the shortest, up; the longest one for larger ranks."""
        upto, rest = np.cumsum(self._counts), np.sort(np.concatenate([np.empty(0), *self._rest]))
        num_counted = int(self._counts.sum())
        if not num_counted + len(rest):
            return np.full(len(ranks), np.nan)
        places = np.minimum(ranks, num_counted + len(rest) - 1)
        ranked = np.searchsorted(upto, places, side="right") / TICKS
        if len(rest):
            ranked = np.where(places < num_counted, ranked, rest[np.maximum(places - num_counted, 0)])
        return np.asarray(ranked)
