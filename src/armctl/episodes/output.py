"""Episodes as tables for other programs, CSV and Parquet. armctl does not read them back."""

import csv
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np

from armctl.core.errors import missing_extra
from armctl.core.files import write_atomically
from armctl.episodes.record import COLUMNS
from armctl.episodes.table import TYPES, EpisodeTable, field_of

EPISODES, DECISIONS, EPISODES_PARQUET = "episodes.csv", "decisions.csv", "episodes.parquet"
CELL = "cell"
DECISION_COLUMNS = ("policy", "episode", "decision_ms")
"""The last column of `decisions.csv` holds the episode's decision times, ms, separated by spaces."""


Cells = EpisodeTable | Mapping[str, EpisodeTable]
"""The episodes of a comparison, or of several cells by their names."""


def write_csv(folder: Path, results: Cells) -> list[Path]:
    """Write `episodes.csv` and `decisions.csv`; return their paths. Raises `OSError`.

    Names of cells are in a first column `cell`.
    """
    cells, selection = _named(results)

    def written(path: Path, names: Sequence[str], columns: Callable[[EpisodeTable], Iterable[Sequence[Any]]]) -> Path:
        parts = ((name, part) for name, table in cells.items() for part in table.parts())
        rows = (zip(*([[name] * len(part), *columns(part)][selection]), strict=True) for name, part in parts)
        return _written(path, (CELL, *names)[selection], itertools.chain.from_iterable(rows))

    def times(part: EpisodeTable) -> list[list[Any]]:
        texts = [" ".join(map(str, spent)) for spent in part.decision_ms().tolist()]
        return [part.column("policy").tolist(), part.column("episode").tolist(), texts]

    return [
        written(folder / EPISODES, COLUMNS, lambda part: part.csv_columns().values()),
        written(folder / DECISIONS, DECISION_COLUMNS, times),
    ]


def write_parquet(folder: Path, results: Cells) -> list[Path]:
    """Write `episodes.parquet`; return its path. Raises `OSError`, and `ConfigurationError` without pyarrow.

    Names of cells are in a first column `cell`.
    """
    cells, selection = _named(results)
    pa, pq = _pyarrow()
    schema = _schema()
    fields = [pa.field(CELL, pa.string(), nullable=False), *schema][selection]

    def write(unfinished: Path) -> None:
        with pq.ParquetWriter(unfinished, pa.schema(fields), compression="zstd") as writer:
            for name, table in cells.items():
                for part in table.parts():
                    names = pa.array([name] * len(part), pa.string())
                    arrays = [names, *_arrays(part, schema)][selection]
                    writer.write_table(pa.table(arrays, schema=pa.schema(fields)))

    write_atomically(folder / EPISODES_PARQUET, write)
    return [folder / EPISODES_PARQUET]


def _named(results: Cells) -> tuple[Mapping[str, EpisodeTable], slice]:
    """Tables by cell, and which columns are shown: not the first one without names of cells."""
    return ({"": results}, slice(1, None)) if isinstance(results, EpisodeTable) else (results, slice(None))


def _written(path: Path, columns: Sequence[str], rows: Iterable[Iterable[Any]]) -> Path:
    def write(unfinished: Path) -> None:
        with unfinished.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(itertools.chain([columns], rows))

    write_atomically(path, write)
    return path


def _schema() -> Any:
    """Return the columns of a Parquet file, those of `episodes.csv` and `decision_ms`, with their types."""
    pa, _ = _pyarrow()
    plain = {str: pa.string(), int: pa.int64(), bool: pa.bool_(), float: pa.float64()}
    number = pa.field("value", pa.float64(), nullable=False)
    special = {
        "optimality_gap": pa.float64(),
        "reward_terms": pa.map_(pa.string(), number),
        "decision_ms": pa.list_(number.with_name("element")),
    }

    def field(name: str) -> Any:
        if name in special:
            return pa.field(name, special[name], nullable=False)
        (kind,) = (kinds := TYPES[field_of(name)]) - {NoneType}
        return pa.field(name, plain[kind], nullable=NoneType in kinds)

    return pa.schema([field(name) for name in (*COLUMNS, "decision_ms")])


def _arrays(results: EpisodeTable, schema: Any) -> list[Any]:
    """Return the results as Arrow's arrays."""
    pa, _ = _pyarrow()
    names, rewards = results.reward_terms()
    starts = np.concatenate(([0], np.cumsum([*map(len, names)], dtype=int)))
    terms = pa.array(list(itertools.chain.from_iterable(names)), pa.string()), pa.array(rewards)
    times = results.decision_ms()

    def array(field: Any) -> Any:
        match field.name:
            case "reward_terms":
                return pa.MapArray.from_arrays(pa.array(starts, pa.int32()), *terms, type=field.type)
            case "decision_ms":
                return pa.ListArray.from_arrays(pa.array(times.ends, pa.int32()), pa.array(times.values), field.type)
            case "optimality_gap":
                return pa.array(results.optimality_gap)
            case name:
                return pa.array(results.column(field_of(name)), field.type, from_pandas=False)

    return [array(field) for field in schema]


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError as error:
        raise missing_extra("episodes.parquet", error, "parquet") from error
    return pyarrow, pyarrow.parquet
