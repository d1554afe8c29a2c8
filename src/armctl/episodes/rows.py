"""An episode as a row of the store's table, and a table of episodes from such rows.

Texts are kept once, and referred to by number. Decision times are whole numbers of 0.1 us, of 2 bytes each or 4 as they
need, or of 8 bytes if they are none. Each row has a checksum of its values, its texts and the identity of its cell.
"""

import itertools
import json
import math
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import NoneType
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.envs import ERROR
from armctl.episodes.columns import TICKS, UNKNOWN_TICKS, Column, Pages, Ragged, is_unknown, milliseconds
from armctl.episodes.record import LARGEST_RETURN, EpisodeResult
from armctl.episodes.table import FEW, TYPES, EpisodeTable, array

TEXTS = ("policy", "outcome", "run", "terms")
"""Columns of numbers of texts; `terms` is the names of the reward terms, a JSON list."""
INTEGERS = tuple(name for name, kinds in TYPES.items() if kinds & {int, bool} and name != "seed")
NUMBERS = tuple(name for name, kinds in TYPES.items() if float in kinds)
SINCE_FORMAT_2 = ("joint_jerk_max", "joint_jerk_rms", "tip_jerk_max", "tip_jerk_rms", "intervention_share",
                  "intervention_size")  # fmt: skip
"""Numbers that rows of format 1 do not have. They count in a row's checksum where one of them is known."""
NUMBERS_OF_FORMAT_1 = tuple(name for name in NUMBERS if name not in SINCE_FORMAT_2)
COLUMNS = (*TEXTS, *INTEGERS, *NUMBERS, "reward_terms", "decision_ms", "checksum")
"""Columns of the table `episode`. Environment and seed of an episode are in its cell's identity."""
_UNKNOWN = -(2**63)
"""Number in place of None in a checksum."""
_ABSENT = float.fromhex("-0x1.61726d63746c6p-1000")
"""Number in place of a measure's NULL in a query: it is packed at once, and None is not. No measure is just that."""
_KINDS = {2: "<u2", 4: "<i4", 8: "<f8"}
"""Types of decision times by their bytes: in ticks, or in ms where they are no whole ticks."""
ROWS_AT_ONCE = 1_000
"""Rows that are read together: values of more do not stay in the processor's cache."""
BATCHES_IN_MEMORY = 64
"""Batches after which what was read of a large table leaves the memory."""
_PACKED = struct.Struct(f"<{len(TEXTS) + len(INTEGERS)}q{len(NUMBERS_OF_FORMAT_1)}d")
_PACKED_SINCE = struct.Struct(f"<{len(SINCE_FORMAT_2)}d")
_LAYOUT = (*TEXTS, *INTEGERS, *NUMBERS_OF_FORMAT_1, *SINCE_FORMAT_2)
"""Numbers of a row in the order in which its checksum takes them."""
_NUM_INTEGERS = len(TEXTS) + len(INTEGERS)
_NULLS = np.array([_UNKNOWN] * _NUM_INTEGERS + [np.array(math.nan).view(np.int64)] * len(NUMBERS))
"""Numbers of a row in which all are NULL, as integers."""
NULLABLE = (*(name for name in INTEGERS if NoneType in TYPES[name]), *NUMBERS)
"""Columns that may be NULL."""
_NO_FIT = "it has decision times that do not fit the length of an episode"


def definition(numbers: Sequence[str] = NUMBERS) -> str:
    """Return the columns of the table `episode` in SQL, with these numbers."""

    def kind(name: str) -> str:
        return f"{name} INTEGER{'' if NoneType in TYPES.get(name, ()) else ' NOT NULL'}"

    integers = ", ".join(map(kind, (*TEXTS, *INTEGERS)))
    reals = ", ".join(f"{name} REAL" for name in numbers)
    return f"{integers}, {reals}, reward_terms BLOB NOT NULL, decision_ms BLOB NOT NULL, checksum INTEGER NOT NULL"


def row_of(result: EpisodeResult, texts: dict[str, int], cell_checksum: int) -> tuple[Any, ...]:
    """Return an episode's row; new texts get the next numbers. `cell_checksum` is that of its cell's identity."""
    values = vars(result) | vars(result.metrics)
    values["terms"] = json.dumps(list(result.reward_terms))
    numbers = [texts.setdefault(values[name], len(texts)) for name in TEXTS]
    integers = [None if (value := values[name]) is None else int(value) for name in INTEGERS]
    floats = {name: float(values[name]) + 0.0 for name in NUMBERS}  # SQLite has no -0.0, and no NaN but NULL
    rewards = np.array([*result.reward_terms.values()], "<f8").tobytes()
    times = _packed_times(result.decision_ms)
    packed = _PACKED.pack(
        *(_text_checksum(values[name]) for name in TEXTS),
        *(_UNKNOWN if value is None else value for value in integers),
        *(math.nan if (value := floats[name]) != value else value for name in NUMBERS_OF_FORMAT_1),
    )
    since = [math.nan if (value := floats[name]) != value else value for name in SINCE_FORMAT_2]
    if not all(map(math.isnan, since)):
        packed += _PACKED_SINCE.pack(*since)
    checksum = crc32(times, crc32(rewards, crc32(packed, cell_checksum)))
    return (*numbers, *integers, *floats.values(), rewards, times, checksum)


class Sizes(NamedTuple):
    """Sizes of a table, which say how much memory it takes."""

    rows: int = 0
    rewards: int = 0
    decisions: int = 0
    width: int = 0
    """Bytes of a decision time, in the episode in which it has most."""
    non_null: tuple[int, ...] = (0,) * len(NULLABLE)
    """Rows in which each of `NULLABLE` is not NULL."""

    def joined(self, other: "Sizes") -> "Sizes":
        """Return the sizes of two tables together."""
        rows, rewards, decisions = (a + b for a, b in zip(self[:3], other[:3], strict=True))
        non_null = tuple(a + b for a, b in zip(self.non_null, other.non_null, strict=True))
        return Sizes(rows, rewards, decisions, max(self.width, other.width), non_null)

    @property
    def selected(self) -> dict[str, str]:
        """Columns of the table `episode` that are not NULL throughout, with how a query asks for them."""
        terms = {name: name for name in COLUMNS}
        for name, non_null in zip(NULLABLE, self.non_null, strict=True):
            if not non_null:
                del terms[name]
            elif non_null < self.rows:
                terms[name] = f"coalesce({name}, {':absent' if name in NUMBERS else ':unknown'})"
        return terms


PLACEHOLDERS = {"unknown": _UNKNOWN, "absent": _ABSENT}
"""Parameters of such a query."""


def sizes_of(rows: Sequence[Sequence[Any]]) -> Sizes:
    """Return the sizes of a table of some rows."""
    sizes = Sizes()
    for values in (dict(zip(COLUMNS, row, strict=True)) for row in rows):
        rewards, times, length = len(values["reward_terms"]) // 8, len(values["decision_ms"]), values["length"]
        non_null = tuple(int(values[name] is not None) for name in NULLABLE)
        sizes = sizes.joined(Sizes(1, rewards, length, times // max(length, 1), non_null))
    return sizes


def selected_rows(rows: Iterable[Sequence[Any]], sizes: Sizes) -> Iterator[Sequence[Any]]:
    """Yield rows as a query for a table of these sizes has them."""
    for row in rows:
        values = {name: _ABSENT if name in NUMBERS else _UNKNOWN for name in NULLABLE}
        values |= {name: value for name, value in zip(COLUMNS, row, strict=True) if value is not None}
        yield [values[name] for name in sizes.selected]


def table_of_rows(
    rows: Iterable[Sequence[Any]],
    sizes: Sizes,
    texts: Sequence[str],
    cell_checksum: int,
    env: str,
    seed: int,
    policies: Sequence[str] | None = None,
) -> EpisodeTable:
    """Return the episodes in some rows, with the columns that are `selected` for a table of these sizes.

    Raises `ValueError` for a row that was changed, or belongs to another cell. With `policies`, as in a file that
    anybody may have written, also for one that cannot be an episode of these.
    """
    if not sizes.rows:
        return EpisodeTable()
    if sizes.width not in (0, *_KINDS):
        raise ValueError(_NO_FIT)
    time_type = np.dtype(_KINDS[sizes.width or min(_KINDS)])
    types = {name: (_type_of(name), sizes.rows) for name in _LAYOUT}
    types |= {"reward_terms": (np.dtype(float), sizes.rewards), "decision_ms": (time_type, sizes.decisions)}
    ends_of_lists = 2 * 8 * (sizes.rows + 1)
    pages = Pages(sum(8 + kind.itemsize * size for kind, size in types.values()) + ends_of_lists)
    columns = {name: pages.array(size, kind) for name, (kind, size) in types.items()}
    reader = _Reader(texts, cell_checksum, [*sizes.selected], time_type, policies)
    ends = dict.fromkeys(columns, 0)
    for i, batch in enumerate(_batches(rows)):
        for name, values in reader.read(batch).items():
            columns[name][ends[name] : (end := ends[name] + len(values))] = values
            ends[name] = end
        if i % BATCHES_IN_MEMORY == 0:
            pages.release()
    return reader.table({name: values[: ends[name]] for name, values in columns.items()}, env, seed, pages)


def _type_of(name: str) -> "np.dtype[Any]":
    """Return the type of the numbers of a column."""
    if name in NUMBERS:
        return np.dtype(float)
    if name in FEW or name in TEXTS:
        return np.dtype(np.int32)
    return np.dtype(bool if bool in TYPES[name] else np.int64)


class _Reader:
    """Reads rows with the columns `selected`, whose decision times fit a `time_type`."""

    def __init__(
        self,
        texts: Sequence[str],
        cell_checksum: int,
        selected: Sequence[str],
        time_type: "np.dtype[Any]",
        policies: Sequence[str] | None,
    ) -> None:
        self._texts = np.array([*texts, ""], object)[:-1]
        self._checksums = np.array([*map(_text_checksum, texts)], np.int64)
        self._cell_checksum, self._time_type, self._policies = cell_checksum, time_type, policies
        numbers = selected[: -len(("reward_terms", "decision_ms", "checksum"))]
        self._pack = struct.Struct("<" + "".join("d" if name in NUMBERS else "q" for name in numbers)).pack
        self._places = [_LAYOUT.index(name) for name in numbers]
        self._numbers = np.tile(_NULLS, (ROWS_AT_ONCE, 1))
        """Numbers of the rows that are read together; of columns that are not selected, they stay NULL."""
        self._different: dict[str, dict[Any, int]] = {name: {} for name in INTEGERS if name in FEW}
        """Different values of columns with few, and their places."""

    def read(self, batch: Sequence[Sequence[Any]]) -> dict[str, NDArray[Any]]:
        """Return the columns of some rows, the ragged ones one list after the other."""
        packed = np.frombuffer(b"".join([self._pack(*row[:-3]) for row in batch]), "<i8")
        numbers = self._numbers[: len(batch)]
        numbers[:, self._places] = packed.reshape(len(batch), -1)
        integers, reals = numbers[:, :_NUM_INTEGERS], numbers[:, _NUM_INTEGERS:].view("<f8")
        reals[reals == _ABSENT] = math.nan
        columns: dict[str, NDArray[Any]] = dict(zip(_LAYOUT, [*integers.T, *reals.T], strict=True))
        texts = integers[:, : len(TEXTS)].copy()
        if texts.min() < 0:
            raise ValueError("it refers to a text that is not there")
        columns |= zip(TEXTS, texts.T, strict=True)
        integers[:, : len(TEXTS)] = self._checksums[texts]
        self._check_sums(batch, numbers)
        columns["reward_terms"] = np.frombuffer(b"".join([row[-3] for row in batch]), "<f8")
        columns["decision_ms"] = _unpacked_times([row[-2] for row in batch], columns["length"], self._time_type)
        if self._policies is not None:
            named = {name: self._texts[columns[name]] for name in ("policy", "outcome")}
            _check_possible(columns | named, self._policies)
        return columns | {name: self._places_of(name, columns[name]) for name in self._different}

    def _check_sums(self, batch: Sequence[Sequence[Any]], numbers: NDArray[np.int64]) -> None:
        since = numbers[:, -len(SINCE_FORMAT_2) :].view("<f8")
        widths = np.where(np.isnan(since).all(axis=1), _PACKED.size, _PACKED.size + _PACKED_SINCE.size)
        data, starts = numbers.data.cast("B"), np.arange(len(batch)) * 8 * len(_LAYOUT)
        for row, start, end in zip(batch, starts.tolist(), (starts + widths).tolist(), strict=True):
            if crc32(row[-2], crc32(row[-3], crc32(data[start:end], self._cell_checksum))) != row[-1]:
                raise ValueError("an episode was changed, or belongs to another comparison")

    def _places_of(self, name: str, values: NDArray[np.int64]) -> NDArray[np.intp]:
        """Return where values are among the different ones of their column, to which new ones are added."""
        different, codes = np.unique(values, return_inverse=True)
        kind, places = bool if bool in TYPES[name] else int, self._different[name]
        uniques = [
            None if NoneType in TYPES[name] and value == _UNKNOWN else kind(value) for value in different.tolist()
        ]
        return np.array([places.setdefault(value, len(places)) for value in uniques])[codes]

    def table(self, columns: dict[str, NDArray[Any]], env: str, seed: int, pages: Pages) -> EpisodeTable:
        """Return the table of all columns."""
        terms, rewards, times = (columns.pop(name) for name in ("terms", "reward_terms", "decision_ms"))
        used = set(np.unique(terms).tolist())
        names = [_names(text) if i in used else () for i, text in enumerate(self._texts)]
        counts = np.array([*map(len, names)])[terms]
        if len(rewards) != counts.sum():
            raise ValueError("it has an episode with too few or too many reward terms")
        different = {name: array(name, [*places]) for name, places in self._different.items()}
        different |= dict.fromkeys(TEXTS, self._texts)
        fields = {name: Column(values, different.get(name)) for name, values in columns.items()}
        same = np.broadcast_to(np.int32(0), len(terms))
        fields |= {"env": Column(same, array("env", [env])), "seed": Column(same, array("seed", [seed]))}
        lists = Ragged.of(rewards, counts, pages), Ragged.of(times, columns["length"], pages)
        pages.release()
        return EpisodeTable.of_columns(fields, names, terms, *lists, pages)


def _check_possible(columns: Mapping[str, NDArray[Any]], policies: Sequence[str]) -> None:
    """Raise `ValueError` unless all may be episodes of these policies."""
    if not set(columns["policy"].tolist()) <= set(policies):
        raise ValueError("it has an episode that is not of this comparison")
    if (first := columns["episode"].min()) < 0:
        raise ValueError(f"{first} is not the number of an episode")
    for name, values in {"return": columns["total_reward"], "reward_terms": columns["reward_terms"]}.items():
        if len(odd := values[~(np.abs(values) <= LARGEST_RETURN)]):
            raise ValueError(f"{name} has {odd[0]}, and should be between -{LARGEST_RETURN:g} and {LARGEST_RETURN:g}")
    times, lengths = columns["decision_ms"], columns["length"]
    if (columns["outcome"][lengths == 0] != ERROR).any():
        raise ValueError(f"it has an episode without decision times whose outcome is not {ERROR!r}")
    firsts = (np.cumsum(lengths) - lengths)[lengths > 0]
    if is_unknown(times[firsts]).any() or _no_times(times).any():
        raise ValueError("it has decision times that are no times: numbers from 0 on, and nan where none began")
    if _no_times(columns["reset_ms"]).any():
        raise ValueError("it has a reset_ms that is no time")


def _no_times(times: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray(((times < 0) & ~is_unknown(times)) | np.isinf(times))


def _batches(rows: Iterable[Sequence[Any]]) -> Iterator[list[Sequence[Any]]]:
    remaining = iter(rows)
    while batch := list(itertools.islice(remaining, ROWS_AT_ONCE)):
        yield batch


def _packed_times(decision_ms: Array) -> bytes:
    """Times in as few bytes as hold all of them exactly."""
    unknown = np.isnan(decision_ms)
    ticks = np.where(unknown, 0.0, np.rint(decision_ms * TICKS))
    if ((ticks / TICKS == decision_ms) | unknown).all() and (ticks >= 0).all():
        for kind, placeholder in UNKNOWN_TICKS.items():
            if ticks.max(initial=0) < placeholder % 2**31:
                return np.where(unknown, placeholder, ticks).astype(f"<{kind}").tobytes()
    return decision_ms.astype("<f8").tobytes()


def _unpacked_times(packed: Sequence[bytes], lengths: NDArray[np.int64], kind: "np.dtype[Any]") -> NDArray[Any]:
    """Return times as numbers of a type that holds all of them."""
    sizes = np.array([*map(len, packed)])
    if (sizes == kind.itemsize * lengths).all():
        return np.frombuffer(b"".join(packed), kind)
    widths = sizes // np.maximum(lengths, 1)
    present = set(widths[lengths > 0].tolist())
    if (sizes != widths * lengths).any() or not present <= {*_KINDS}:
        raise ValueError(_NO_FIT)
    times, places = np.empty(int(lengths.sum()), kind), np.repeat(widths, lengths)
    for width in present:
        data = b"".join(itertools.compress(packed, (widths == width).tolist()))
        values = np.frombuffer(data, _KINDS[width])
        if kind.kind == "f":
            times[places == width] = milliseconds(values)
        else:
            times[places == width] = np.where(is_unknown(values), kind.type(UNKNOWN_TICKS[kind.str[1:]]), values)
    return times


def _text_checksum(text: str) -> int:
    return crc32(text.encode())


def _names(text: str) -> tuple[str, ...]:
    names = json.loads(text)
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names) and len(set(names)) == len(names)):
        raise ValueError("it has names of reward terms that are none")
    return tuple(names)
