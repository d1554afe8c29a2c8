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
from armctl.episodes.record import LARGEST_RETURN, EpisodeResult
from armctl.episodes.table import TYPES, EpisodeTable, Ragged, column

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
_TICKS = 1e4
"""Number of ticks in 1 ms."""
_WIDTHS = {2: ("<u2", 2**16 - 1), 4: ("<i4", -1)}
"""Types of decision times in ticks, by their bytes, with the number in place of NaN."""
ROWS_AT_ONCE = 1_000
"""Rows that are read together: values of more do not stay in the processor's cache."""
_PACKED = struct.Struct(f"<{len(TEXTS) + len(INTEGERS)}q{len(NUMBERS_OF_FORMAT_1)}d")
_PACKED_SINCE = struct.Struct(f"<{len(SINCE_FORMAT_2)}d")


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

    rows: int
    rewards: int
    decisions: int
    """Number of decisions, or a larger one."""


def sizes_of(rows: Sequence[Sequence[Any]]) -> Sizes:
    """Return the sizes of a table of some rows."""
    lengths = [[len(row[COLUMNS.index(name)]) for row in rows] for name in ("reward_terms", "decision_ms")]
    return Sizes(len(rows), sum(lengths[0]) // 8, sum(lengths[1]) // min(_WIDTHS))


def table_of_rows(
    rows: Iterable[Sequence[Any]],
    sizes: Sizes,
    texts: Sequence[str],
    cell_checksum: int,
    env: str,
    seed: int,
    policies: Sequence[str] | None = None,
) -> EpisodeTable:
    """Return the episodes in some rows. Raises `ValueError` for a row that was changed, or belongs to another cell.

    With `policies`, as in a file that anybody may have written, also for one that cannot be an episode of these.
    """
    text_values, checksums = np.array([*texts, ""], object)[:-1], np.array([*map(_text_checksum, texts)], np.int64)
    columns: dict[str, NDArray[Any]] = {}
    ends = dict.fromkeys(COLUMNS, 0)
    for batch in _batches(rows):
        checked = _checked(batch, checksums, cell_checksum)
        checked |= {name: text_values[checked[name]] for name in TEXTS if name != "terms"}
        if policies is not None:
            _check_possible(checked, policies)
        for name, values in checked.items():
            if name not in columns:
                size = {"reward_terms": sizes.rewards, "decision_ms": sizes.decisions}.get(name, sizes.rows)
                columns[name] = np.empty(size, values.dtype)
            columns[name][ends[name] : (end := ends[name] + len(values))] = values
            ends[name] = end
    if not columns:
        return EpisodeTable()
    columns = {name: values[: ends[name]] for name, values in columns.items()}
    term_codes, lengths = columns.pop("terms"), columns["length"]
    used = set(np.unique(term_codes).tolist())
    names = [_names(text) if i in used else () for i, text in enumerate(texts)]
    counts = np.array([*map(len, names)])[term_codes]
    rewards, times = columns.pop("reward_terms"), columns.pop("decision_ms")
    if len(rewards) != counts.sum():
        raise ValueError("it has an episode with too few or too many reward terms")
    columns |= {name: column(name, columns[name].tolist()) for name in INTEGERS if NoneType in TYPES[name]}
    columns |= {"env": np.full(len(lengths), env, object), "seed": np.full(len(lengths), seed)}
    return EpisodeTable.of_columns(columns, names, term_codes, Ragged.of(rewards, counts), Ragged.of(times, lengths))


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
    if np.isnan(times[firsts]).any() or _no_times(times).any():
        raise ValueError("it has decision times that are no times: numbers from 0 on, and nan where none began")
    if _no_times(columns["reset_ms"]).any():
        raise ValueError("it has a reset_ms that is no time")


def _no_times(values: Array) -> NDArray[np.bool_]:
    return np.asarray((values < 0) | np.isinf(values))


def _batches(rows: Iterable[Sequence[Any]]) -> Iterator[list[Sequence[Any]]]:
    remaining = iter(rows)
    while batch := list(itertools.islice(remaining, ROWS_AT_ONCE)):
        yield batch


def _checked(
    batch: list[Sequence[Any]], text_checksums: NDArray[np.int64], cell_checksum: int
) -> dict[str, NDArray[Any]]:
    """Return the columns of some rows, the ragged ones one list after the other."""
    columns: dict[str, Any] = dict(zip(COLUMNS, zip(*batch, strict=True), strict=True))
    arrays: dict[str, NDArray[Any]] = {name: np.array(columns[name], np.int64) for name in TEXTS}
    if min(int(numbers.min()) for numbers in arrays.values()) < 0:
        raise ValueError("it refers to a text that is not there")
    packed = [text_checksums[numbers] for numbers in arrays.values()]
    for name in INTEGERS:
        values = columns[name]
        unknown = None in values
        packed.append(
            np.array([_UNKNOWN if value is None else value for value in values] if unknown else values, np.int64)
        )
        arrays[name] = _integers(name, packed[-1], unknown)
    for name in NUMBERS:
        arrays[name] = np.array(columns[name], float)
    packed += [arrays[name].view(np.int64) for name in NUMBERS_OF_FORMAT_1]
    since = np.column_stack([arrays[name] for name in SINCE_FORMAT_2])
    data, width = np.column_stack([*packed, since.view(np.int64)]).astype("<i8").tobytes(), 8 * len(packed)
    stride = width + _PACKED_SINCE.size
    ends = np.where(np.isnan(since).all(axis=1), width, stride).tolist()
    blobs = zip(columns["reward_terms"], columns["decision_ms"], columns["checksum"], ends, strict=True)
    for at, (rewards, times, checksum, end) in zip(range(0, len(data), stride), blobs, strict=True):
        if crc32(times, crc32(rewards, crc32(data[at : at + end], cell_checksum))) != checksum:
            raise ValueError("an episode was changed, or belongs to another comparison")
    arrays["reward_terms"] = np.frombuffer(b"".join(columns["reward_terms"]), "<f8")
    arrays["decision_ms"] = _unpacked_times(columns["decision_ms"], arrays["length"])
    return arrays


def _integers(name: str, values: NDArray[np.int64], unknown: bool) -> NDArray[Any]:
    kinds = TYPES[name]
    typed: NDArray[Any] = values.astype(bool) if bool in kinds else values
    if NoneType not in kinds:
        return typed
    typed = typed.astype(object)  # in every batch alike
    if unknown:
        typed[values == _UNKNOWN] = None
    return typed


def _packed_times(decision_ms: Array) -> bytes:
    """Times in as few bytes as hold all of them exactly."""
    unknown = np.isnan(decision_ms)
    ticks = np.where(unknown, 0.0, np.rint(decision_ms * _TICKS))
    if ((ticks / _TICKS == decision_ms) | unknown).all() and (ticks >= 0).all():
        for kind, placeholder in _WIDTHS.values():
            if ticks.max(initial=0) < placeholder % 2**31:
                return np.where(unknown, placeholder, ticks).astype(kind).tobytes()
    return decision_ms.astype("<f8").tobytes()


def _unpacked_times(packed: Sequence[bytes], lengths: NDArray[np.int64]) -> Array:
    sizes = np.array([*map(len, packed)])
    widths = sizes // np.maximum(lengths, 1)
    if (sizes != widths * lengths).any() or not set(widths[lengths > 0].tolist()) <= {*_WIDTHS, 8}:
        raise ValueError("it has decision times that do not fit the length of an episode")
    times, places = np.empty(int(lengths.sum())), np.repeat(widths, lengths)
    for width in set(widths.tolist()):
        data = b"".join(itertools.compress(packed, (widths == width).tolist()))
        kind, placeholder = _WIDTHS.get(width, ("<f8", None))
        values = np.frombuffer(data, kind)
        times[places == width] = np.where(values == placeholder, math.nan, values / _TICKS) if placeholder else values
    return times


def _text_checksum(text: str) -> int:
    return crc32(text.encode())


def _names(text: str) -> tuple[str, ...]:
    names = json.loads(text)
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names) and len(set(names)) == len(names)):
        raise ValueError("it has names of reward terms that are none")
    return tuple(names)
