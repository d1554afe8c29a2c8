"""Episodes as a Parquet file: small, typed, and quickly read, by armctl and by pandas, Polars or DuckDB.

Its columns are those of `episodes.csv`, and `decision_ms`, the time of every decision. Its metadata holds the digest of
the comparison's identity and a checksum of each row group's values, by which a changed value is noticed.
"""

import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ResultsError, missing_extra
from armctl.core.files import digest, opened_regular, sealed, unsealed, write_atomically
from armctl.core.registration import bare_id
from armctl.envs import ERROR
from armctl.episodes.columns import Array
from armctl.episodes.record import COLUMNS, LARGEST_RETURN
from armctl.episodes.table import TYPES, EpisodeTable

ROWS = 10_000
"""Episodes of a row group: as many are in memory twice, at once."""
LARGEST_FILE, MOST_VALUES = 4 * 2**30, 2**28
"""Bytes of a file, packed or unpacked, and values in a row group."""
_OLDER = [name for name in COLUMNS if name != "reset_ms"]
"""Columns of files of older versions."""
_KEY = "armctl"
_TEXTS = [*(name for name in COLUMNS if TYPES.get(name) is str), "reward_terms.key_value.key"]
"""Columns that are read as indices of the different texts in them, which a small file could repeat endlessly."""
_Integers = NDArray[np.integer[Any]]


@dataclass(frozen=True)
class _Group:
    """The values of a row group, as `EpisodeTable.extend` takes them: numbers, or different values and indices."""

    numbers: Mapping[str, NDArray[Any]]
    repeated: Mapping[str, tuple[list[Any], _Integers]]
    terms: tuple[list[str], _Integers]
    """The names of reward terms, of one episode after the other."""
    term_counts: _Integers
    earned: Array
    decision_ms: Array
    decisions: _Integers

    @property
    def checksum(self) -> str:
        """Of all values."""
        found = hashlib.sha256()
        for name, numbers in (*self.numbers.items(), ("earned", self.earned), ("decision_ms", self.decision_ms)):
            found.update(name.encode() + numbers.astype("<f8").tobytes())
        for name, (values, codes) in (*self.repeated.items(), ("terms", self.terms)):
            found.update((name + json.dumps(values)).encode() + codes.astype("<i8").tobytes())
        for counts in (self.term_counts, self.decisions):
            found.update(counts.astype("<i8").tobytes())
        return found.hexdigest()[:16]

    def check(self, comparison: Mapping[str, Any]) -> None:
        """Raise `ValueError` unless all may be episodes of the comparison, as `EpisodeResult.from_row` and so on."""
        allowed = {"env": [bare_id(comparison["env"])], "seed": [comparison["seed"]], "policy": comparison["policies"]}
        lengths, codes = self.repeated["length"]
        if any(value not in allowed[name] for name in allowed for value in self.repeated[name][0]) or not (
            np.array_equal(np.array(lengths)[codes], self.decisions)
        ):
            raise ValueError("it has an episode that is not of this comparison")
        if (first := self.numbers["episode"].min(initial=0)) < 0:
            raise ValueError(f"{first} is not the number of an episode")
        for name, values in {"return": self.numbers["total_reward"], "reward_terms": self.earned}.items():
            if len(odd := values[~(np.abs(values) <= LARGEST_RETURN)]):
                raise ValueError(
                    f"{name} has {odd[0]}, and should be between -{LARGEST_RETURN:g} and {LARGEST_RETURN:g}"
                )
        outcomes, codes = self.repeated["outcome"]
        decided = self.decisions > 0
        if (np.array(outcomes, object)[codes[~decided]] != ERROR).any():
            raise ValueError(f"it has an episode without decision times whose outcome is not {ERROR!r}")
        firsts = self.decision_ms[(np.cumsum(self.decisions) - self.decisions)[decided]]
        if np.isnan(firsts).any() or not (np.isnan(self.decision_ms) | (self.decision_ms >= 0)).all():
            raise ValueError("it has decision times that are no times: numbers from 0 on, and nan where none began")
        resets = self.numbers.get("reset_ms", np.empty(0))
        if not (np.isnan(resets) | ((resets >= 0) & np.isfinite(resets))).all():
            raise ValueError("it has a reset_ms that is no time")
        if np.isinf(self.decision_ms).any():
            raise ValueError("it has decision times that are infinite")


def check_parquet() -> None:
    """Raise `ConfigurationError` if pyarrow, of the extra `parquet`, is not installed."""
    _pyarrow()


def write_parquet(path: Path, own: str, results: EpisodeTable) -> None:
    """Replace a file by these results. `own` is the digest of the comparison's identity. Raises `OSError`."""
    pa, pq = _pyarrow()
    schema, checksums = _schema(), []

    def write(unfinished: Path) -> None:
        with unfinished.open("wb") as file, pq.ParquetWriter(file, schema, compression="zstd") as writer:
            for first in range(0, len(results), ROWS):
                group = pa.table(_columns(results[first : first + ROWS], schema), schema=schema)
                checksums.append(_values(group).checksum)
                writer.write_table(group)
            writer.add_key_value_metadata({_KEY: sealed({"comparison": own, "checksums": checksums})})

    write_atomically(path, write)


def read_parquet(path: Path, comparison: Mapping[str, Any], kept: EpisodeTable) -> None:
    """Add the episodes in a file to `kept`, in file order. Raises `ResultsError` for a damaged file."""
    pa, _ = _pyarrow()
    try:
        for group in _groups(path, comparison):
            names = np.array([*group.terms[0], None], object)[group.terms[1]].tolist()
            ends = np.cumsum(group.term_counts).tolist()
            terms = [tuple(names[first:end]) for first, end in itertools.pairwise([0, *ends])]
            numbers = {"reset_ms": np.full(len(terms), np.nan), **group.numbers}  # unknown in files of older versions
            kept.extend(numbers, group.repeated, (terms, group.earned), (group.decision_ms, group.decisions))
    except (OSError, ValueError, KeyError, TypeError, OverflowError, pa.ArrowException) as error:
        raise ResultsError(f"{path} is damaged ({error}): remove it, or overwrite all (--overwrite)") from error


def _groups(path: Path, comparison: Mapping[str, Any]) -> Iterator[_Group]:
    """The row groups of a file, each of which was checked."""
    _, pq = _pyarrow()
    with opened_regular(path, LARGEST_FILE) as opened:
        plain = pq.ParquetFile(opened)
        if not any(plain.schema_arrow.equals(_schema(columns)) for columns in (COLUMNS, _OLDER)):
            raise ValueError(f"it does not have the columns {', '.join((*COLUMNS, 'decision_ms'))}, of their types")
        file = pq.ParquetFile(opened, metadata=plain.metadata, read_dictionary=_TEXTS)
        about = unsealed((file.metadata.metadata or {}).get(_KEY.encode(), b"null"))
        if about.get("comparison") != digest(comparison):
            raise ValueError("it belongs to another comparison")
        for i, checksum in zip(range(file.num_row_groups), about["checksums"], strict=True):
            _check_size(file.metadata.row_group(i))
            group = _values(file.read_row_group(i, use_threads=False))
            if group.checksum != checksum:
                raise ValueError(f"row group {i} was changed")
            group.check(comparison)
            yield group


def _check_size(group: Any) -> None:
    """Raise `ValueError` for a row group that would take too much memory, by what its metadata says."""
    columns = [group.column(i) for i in range(group.num_columns)]
    values, size = (sum(getattr(one, name) for one in columns) for name in ("num_values", "total_uncompressed_size"))
    if values > MOST_VALUES or size > LARGEST_FILE:
        raise ValueError(f"a row group of {values:,} values and {size:,} bytes is too large")


def _schema(columns: Sequence[str] = COLUMNS) -> Any:
    """The columns of a file, with their types."""
    pa, _ = _pyarrow()
    plain = {str: pa.string(), int: pa.int64(), bool: pa.bool_(), float: pa.float64()}
    number = pa.field("value", pa.float64(), nullable=False)
    special = {
        "return": pa.float64(),
        "optimality_gap": pa.float64(),
        "reward_terms": pa.map_(pa.string(), number),
        "decision_ms": pa.list_(number.with_name("element")),
    }

    def field(name: str) -> Any:
        kinds = set(get_args(TYPES.get(name))) or {TYPES.get(name)}
        kind = special.get(name) or plain[next(iter(kinds - {NoneType}))]
        return pa.field(name, kind, nullable=NoneType in kinds and name not in special)

    return pa.schema([field(name) for name in (*columns, "decision_ms")])


def _columns(results: EpisodeTable, schema: Any) -> list[Any]:
    """Results as Arrow's arrays."""
    pa, _ = _pyarrow()
    names, earned = results.reward_terms()
    keys, (times, counts) = list(itertools.chain.from_iterable(names)), results.decision_ms()

    def offsets(lengths: Sequence[int] | _Integers) -> Any:
        return pa.array(np.concatenate(([0], np.cumsum(lengths))), pa.int32())

    def array(field: Any) -> Any:
        match field.name:
            case "reward_terms":
                starts = offsets(list(map(len, names)))
                return pa.MapArray.from_arrays(starts, pa.array(keys, pa.string()), pa.array(earned), type=field.type)
            case "decision_ms":
                return pa.ListArray.from_arrays(offsets(counts), pa.array(times), type=field.type)
            case "optimality_gap":
                return pa.array(results.optimality_gap)
            case name:
                return pa.array(results.column(_field(name)), field.type, from_pandas=False)

    return [array(field) for field in schema]


def _values(group: Any) -> _Group:
    """The values of a row group, from Arrow's table."""
    pa, _ = _pyarrow()
    columns = {name: group[name].combine_chunks() for name in group.column_names}
    terms, times = columns.pop("reward_terms"), columns.pop("decision_ms")
    numbers = {_field(name): one for name, one in columns.items() if one.type == pa.float64() or name == "episode"}
    ends = terms.offsets.to_numpy()
    keys, earned = (one[ends[0] : ends[-1]] for one in (terms.keys, terms.items))
    return _Group(
        {name: one.to_numpy() for name, one in numbers.items()},
        {name: _coded(one) for name, one in columns.items() if _field(name) not in numbers},
        _coded(keys),
        np.diff(ends),
        earned.to_numpy(),
        times.flatten().to_numpy(),
        times.value_lengths().to_numpy(),
    )


def _coded(column: Any) -> tuple[list[Any], _Integers]:
    """The different values of one of Arrow's arrays, in the order of their first appearance, and the index of each."""
    encoded = column if hasattr(column, "dictionary") else column.dictionary_encode("encode")
    codes, firsts, where = np.unique(encoded.indices.to_numpy(), return_index=True, return_inverse=True)
    order = np.argsort(firsts)
    return encoded.dictionary.take(_pyarrow()[0].array(codes[order])).to_pylist(), np.argsort(order)[where]


def _field(column: str) -> str:
    return "total_reward" if column == "return" else column


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise missing_extra("episodes.parquet (--store parquet)", error, "parquet") from error
    return pyarrow, pyarrow.parquet
