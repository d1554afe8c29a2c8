"""An episode as a row of the store's table `episode_row`.

Texts are kept once, and referred to by number. Decision times are whole numbers of 0.1 us, of 2 bytes each or 4 as they
need, or of 8 bytes if they are none. Each row has a checksum of its values, its texts and the identity of its cell.
"""

import itertools
import json
import math
import struct
from collections.abc import Sequence
from types import NoneType
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.episodes.columns import TICKS, UNKNOWN_TICKS, is_unknown, milliseconds
from armctl.episodes.record import EpisodeResult
from armctl.episodes.table import TYPES

TEXTS = ("policy", "outcome", "run", "terms")
"""Columns of numbers of texts; `terms` is the names of the reward terms, a JSON list."""
INTEGERS = tuple(name for name, kinds in TYPES.items() if kinds & {int, bool} and name != "seed")
NUMBERS = tuple(name for name, kinds in TYPES.items() if float in kinds)
SINCE_FORMAT_2 = ("joint_jerk_max", "joint_jerk_rms", "tip_jerk_max", "tip_jerk_rms", "intervention_share",
                  "intervention_size")  # fmt: skip
"""Numbers that rows of format 1 do not have. They count in a row's checksum where one of them is known."""
NUMBERS_OF_FORMAT_1 = tuple(name for name in NUMBERS if name not in SINCE_FORMAT_2)
COLUMNS = (*TEXTS, *INTEGERS, *NUMBERS, "reward_terms", "decision_ms", "checksum")
"""Columns of the table. Environment and seed of an episode are in its cell's identity."""
LAYOUT = (*TEXTS, *INTEGERS, *NUMBERS_OF_FORMAT_1, *SINCE_FORMAT_2)
"""Numbers of a row in the order in which its checksum takes them."""
NULLABLE = {*(name for name in INTEGERS if NoneType in TYPES[name]), *NUMBERS}
"""Columns that may be NULL."""
UNKNOWN = -(2**63)
"""Number in place of None."""
WRONG_TERMS = "it has an episode with too few or too many reward terms"
NO_FIT = "it has decision times that do not fit the length of an episode"
_KINDS = {2: "<u2", 4: "<i4", 8: "<f8"}
"""Types of decision times by their bytes: in ticks, or in ms where they are no whole ticks."""
_PACKED = struct.Struct(f"<{len(TEXTS) + len(INTEGERS)}q{len(NUMBERS_OF_FORMAT_1)}d")
_PACKED_SINCE = struct.Struct(f"<{len(SINCE_FORMAT_2)}d")


def definition(numbers: Sequence[str] = NUMBERS) -> str:
    """Return the columns of the table in SQL, with these numbers."""
    integers = ", ".join(f"{name} INTEGER{'' if name in NULLABLE else ' NOT NULL'}" for name in (*TEXTS, *INTEGERS))
    reals = ", ".join(f"{name} REAL" for name in numbers)
    return f"{integers}, {reals}, reward_terms BLOB NOT NULL, decision_ms BLOB NOT NULL, checksum INTEGER NOT NULL"


class Texts:
    """The texts that a table refers to by number."""

    def __init__(self, texts: Sequence[str]) -> None:
        self.texts = np.array([*texts, ""], object)[:-1]
        self._checksums = np.array([*map(_text_checksum, texts)], np.int64)
        self._num_terms = np.full(len(texts), -1)
        """Names of reward terms in each text, where they are known."""

    def checksums(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the texts' checksums. Raises `ValueError` or `IndexError` for numbers that no text has."""
        if numbers.min(initial=0) < 0:
            raise ValueError("it refers to a text that is not there")
        return np.asarray(self._checksums[numbers])

    def num_terms(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many reward terms each of some texts (k,) names. Raises `ValueError`."""
        for number in np.unique(numbers[self._num_terms[numbers] < 0]).tolist():
            self._num_terms[number] = len(_names_in(self.texts[number]))
        return np.asarray(self._num_terms[numbers])

    @property
    def term_names(self) -> list[tuple[str, ...]]:
        """Names of reward terms in each text; () in those for which `num_terms` was not called."""
        return [_names_in(text) if num >= 0 else () for text, num in zip(self.texts, self._num_terms, strict=True)]


class Origin(NamedTuple):
    """The properties that all episodes of a cell share."""

    texts: Texts
    checksum: int
    """Checksum of the cell's identity."""
    env: str
    seed: int
    policies: Sequence[str] | None = None
    """Policies that the episodes must be of, and possible in all other respects; None if armctl wrote them itself."""


class Sizes(NamedTuple):
    """Sizes of a table, which say how much memory it takes."""

    episodes: int = 0
    rewards: int = 0
    decisions: int = 0
    width: int = 0
    """Bytes of a decision time, in the row or block in which it has most."""

    def joined(self, other: "Sizes") -> "Sizes":
        """Return the sizes of two tables together."""
        episodes, rewards, decisions = (a + b for a, b in zip(self[:-1], other[:-1], strict=True))
        return Sizes(episodes, rewards, decisions, max(self.width, other.width))

    @property
    def time_type(self) -> "np.dtype[Any]":
        """Type that holds all decision times. Raises `ValueError`."""
        if self.width not in (0, *_KINDS):
            raise ValueError(NO_FIT)
        return np.dtype(_KINDS[self.width or min(_KINDS)])


def sizes_of(rows: Sequence[Sequence[Any]]) -> Sizes:
    """Return the sizes of a table of some rows."""
    sizes = Sizes()
    for values in (dict(zip(COLUMNS, row, strict=True)) for row in rows):
        rewards, times, length = len(values["reward_terms"]) // 8, len(values["decision_ms"]), values["length"]
        sizes = sizes.joined(Sizes(1, rewards, length, times // max(length, 1)))
    return sizes


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
        *(UNKNOWN if value is None else value for value in integers),
        *(math.nan if (value := floats[name]) != value else value for name in NUMBERS_OF_FORMAT_1),
    )
    since = [math.nan if (value := floats[name]) != value else value for name in SINCE_FORMAT_2]
    if not all(map(math.isnan, since)):
        packed += _PACKED_SINCE.pack(*since)
    checksum = crc32(times, crc32(rewards, crc32(packed, cell_checksum)))
    return (*numbers, *integers, *floats.values(), rewards, times, checksum)


def columns_of_rows(
    rows: Sequence[Sequence[Any]], origin: Origin, time_type: "np.dtype[Any]"
) -> dict[str, NDArray[Any]]:
    """Return the columns of some rows, the ragged ones one list after the other.

    Raises `ValueError` or `IndexError` for a row that was changed, or belongs to another cell.
    """
    values = dict(zip(COLUMNS, zip(*rows, strict=True), strict=True))
    columns: dict[str, NDArray[Any]] = {
        name: np.array(values[name], float)
        if name in NUMBERS
        else np.array([UNKNOWN if value is None else value for value in values[name]], np.int64)
        for name in LAYOUT
    }
    numbers = np.stack([column.view(np.int64) for column in columns.values()], axis=1)
    numbers[:, : len(TEXTS)] = origin.texts.checksums(numbers[:, : len(TEXTS)])
    is_short = np.isnan([columns[name] for name in SINCE_FORMAT_2]).all(axis=0)
    widths = np.where(is_short, _PACKED.size, _PACKED.size + _PACKED_SINCE.size)
    data, starts = numbers.data.cast("B"), np.arange(len(rows)) * 8 * len(LAYOUT)
    for row, start, end in zip(rows, starts.tolist(), (starts + widths).tolist(), strict=True):
        if crc32(row[-2], crc32(row[-3], crc32(data[start:end], origin.checksum))) != row[-1]:
            raise ValueError("an episode was changed, or belongs to another comparison")
    if (8 * origin.texts.num_terms(columns["terms"]) != [*map(len, values["reward_terms"])]).any():
        raise ValueError(WRONG_TERMS)
    columns["reward_terms"] = np.frombuffer(b"".join(values["reward_terms"]), "<f8")
    columns["decision_ms"] = _unpacked_times(values["decision_ms"], columns["length"], time_type)
    return columns


def as_type(times: NDArray[Any], time_type: "np.dtype[Any]") -> NDArray[Any]:
    """Return decision times as numbers of a type that holds them."""
    if times.dtype == time_type:
        return times
    if time_type.kind == "f":
        return milliseconds(times)
    return np.where(is_unknown(times), time_type.type(UNKNOWN_TICKS[time_type.str[1:]]), times)


def _packed_times(decision_ms: Array) -> bytes:
    """Times in as few bytes as hold all of them exactly."""
    unknown = np.isnan(decision_ms)
    ticks = np.where(unknown, 0.0, np.rint(decision_ms * TICKS))
    if ((ticks / TICKS == decision_ms) | unknown).all() and (ticks >= 0).all():
        for kind, placeholder in UNKNOWN_TICKS.items():
            if ticks.max(initial=0) < placeholder % 2**31:
                return np.where(unknown, placeholder, ticks).astype(f"<{kind}").tobytes()
    return decision_ms.astype("<f8").tobytes()


def _unpacked_times(packed: Sequence[bytes], lengths: NDArray[np.int64], time_type: "np.dtype[Any]") -> NDArray[Any]:
    sizes = np.array([*map(len, packed)])
    widths = sizes // np.maximum(lengths, 1)
    present = set(widths[lengths > 0].tolist())
    if (sizes != widths * lengths).any() or not present <= {*_KINDS}:
        raise ValueError(NO_FIT)
    times, places = np.empty(int(lengths.sum()), time_type), np.repeat(widths, lengths)
    for width in present:
        data = b"".join(itertools.compress(packed, (widths == width).tolist()))
        times[places == width] = as_type(np.frombuffer(data, _KINDS[width]), time_type)
    return times


def _text_checksum(text: str) -> int:
    return crc32(text.encode())


def _names_in(text: str) -> tuple[str, ...]:
    names = json.loads(text)
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names) and len(set(names)) == len(names)):
        raise ValueError("it has names of reward terms that are none")
    return tuple(names)
