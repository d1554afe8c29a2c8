"""Reads the store of a results folder, which anybody may have written."""

import contextlib
import itertools
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from pydantic import TypeAdapter

from armctl.core.errors import ResultsError
from armctl.core.files import digest, unsealed
from armctl.core.registration import bare_id
from armctl.episodes import blocks
from armctl.episodes.assembly import table_of
from armctl.episodes.blocks import BLOCK_COLUMNS
from armctl.episodes.database import FIRST_WITH_BLOCKS, check_file, connected, damage, files, format_of, rows_table
from armctl.episodes.rows import COLUMNS, LAYOUT, NULLABLE, SINCE_FORMAT_2, Origin, Sizes, Texts, sizes_of
from armctl.episodes.table import EpisodeTable
from armctl.runtime.provenance import Run

STORE = "results.sqlite"
UNDISTURBED = "none"
"""Name, or its last part, of a cell without a disturbance."""
SLOW_DOWN_NAME = "slow-down"
"""Name of the disturbance by a slower computer, in the names of its cells."""
MEASURED = "measured"
"""Latency in real time: the times that decisions take."""
POLICY_SEED = "policy_seed"
"""Key, in a cell's identity, of the secret of its policies' random numbers, in decimal digits."""
_BLOCKS_OF_CELL = "FROM episode_block WHERE cell = ?"
_RUNS = TypeAdapter(list[Run])


@dataclass(frozen=True)
class CellKeys:
    """The part of a cell's identity that its episodes are checked by."""

    env: str
    seed: int
    policies: list[str]


KEYS = TypeAdapter(CellKeys)


class StoredCell(NamedTuple):
    """Content of a store for one cell."""

    identity: dict[str, Any]
    facts: dict[str, Any] | None
    """Facts besides the episodes; None while it is unfinished."""
    runs: list[Run]
    """Those that have played episodes, or told another verdict."""
    episodes: EpisodeTable


class StoredStudy(NamedTuple):
    """Content of a store."""

    record: dict[str, Any]
    """Record of the study besides its cells; empty before the first cell."""
    cells: dict[str, StoredCell]


def read_store(folder: Path) -> StoredStudy:
    """Read the store of a folder. Raises `ResultsError` if it is missing or damaged."""
    with _read(folder) as file:
        texts = texts_in(file)
        record = [unsealed(text) for (text,) in file.execute("SELECT record FROM study LIMIT 2")]
        if len(record) > 1:
            raise ValueError("it has several studies")
        cells = {
            name: StoredCell(
                identity := unsealed(text),
                None if facts is None else unsealed(facts),
                runs_of(file, number),
                episodes_of(file, number, identity, texts),
            )
            for number, name, text, facts in cells_in(file)
        }
        return StoredStudy(record[0] if record else {}, cells)


def read_identities(folder: Path) -> list[dict[str, Any]]:
    """Read what identifies each cell in a folder's store. Raises `ResultsError` if it is missing or damaged."""
    with _read(folder, whole=False) as file:
        return [unsealed(text) for _, _, text, _ in cells_in(file)]


def stored_policy_seed(folder: Path) -> int | None:
    """Return the policy seed in a folder's store; None if there is none that can be read."""
    try:
        return int(read_identities(folder)[0][POLICY_SEED])
    except (ResultsError, LookupError, TypeError, ValueError):
        return None


def judged_runs(folder: Path) -> list[tuple[dict[str, Any], list[Run]]]:
    """Read the identity of each cell in a folder's store, with the runs that told a verdict; nothing if it is damaged.

    The runs are marked as overwritten.
    """
    with contextlib.suppress(ResultsError), _read(folder, whole=False) as file:
        return [
            (unsealed(text), [replace(run, overwritten=True) for run in runs_of(file, number) if run.judged])
            for number, _, text, _ in cells_in(file)
        ]
    return []


@contextlib.contextmanager
def _read(folder: Path, whole: bool = True) -> Iterator[sqlite3.Connection]:
    """Open a folder's store to be read: by itself, unless a run that was killed has left a log to recover from."""
    path = folder / STORE
    if not os.path.lexists(path):
        raise ResultsError(f"{folder} holds no results: armctl compare --out {folder} writes some")
    recovered = any(part.exists() and part.stat().st_size for part in files(path)[1:])
    with damage(path), connected(path, "rw" if recovered else "ro&immutable=1") as file:
        check_file(file, whole)
        yield file


def cells_in(file: sqlite3.Connection) -> list[tuple[int, str, str, str | None]]:
    """Number, name, identity and facts of each cell, in the order in which they were begun."""
    return file.execute("SELECT id, name, identity, facts FROM cell ORDER BY id").fetchall()


def runs_of(file: sqlite3.Connection, cell: int) -> list[Run]:
    """Return the runs of a cell. Raises `ValueError`."""
    records = file.execute("SELECT record FROM run WHERE cell = ?", (cell,))
    return _RUNS.validate_python([unsealed(record) for (record,) in records])


def texts_in(file: sqlite3.Connection) -> list[str]:
    """Return the texts that rows refer to by number. Raises `ValueError`."""
    numbers, texts = [], []
    for number, text in file.execute("SELECT id, text FROM text ORDER BY id"):
        numbers.append(number)
        texts.append(text)
    if numbers != list(range(len(texts))) or len(set(texts)) != len(texts):
        raise ValueError("its texts are not numbered")
    return texts


def episodes_of(file: sqlite3.Connection, cell: int, identity: Mapping[str, Any], texts: Sequence[str]) -> EpisodeTable:
    """Return the episodes of a cell in a file that may come from a stranger. Raises `ValueError`."""
    table = episodes_in(file, cell, origin_of(identity, texts, is_strange=True))
    if any(len(np.unique(part.column("episode"))) < len(part) for part in table.by_policy().values()):
        raise ValueError("it has an episode for the second time")
    return table


def episodes_in(
    file: sqlite3.Connection, cell: int, origin: Origin, unwritten: Sequence[Sequence[Any]] = ()
) -> EpisodeTable:
    """Return the episodes of a cell, and those in rows that could not be written. Raises `ValueError`."""
    rows = itertools.chain(rows_in(file, cell), unwritten)
    return table_of(rows, blocks_in(file, cell), sizes_in(file, cell).joined(sizes_of(unwritten)), origin)


def rows_in(file: sqlite3.Connection, cell: int) -> Iterator[tuple[Any, ...]]:
    """Return the rows of a cell's episodes, by `COLUMNS`."""
    missing = SINCE_FORMAT_2 if format_of(file) == 1 else ()
    columns = ", ".join("NULL" if name in missing else name for name in COLUMNS)
    return file.execute(f"SELECT {columns} {_rows_of_cell(file)}", (cell,))


def blocks_in(file: sqlite3.Connection, cell: int, columns: Sequence[str] = BLOCK_COLUMNS) -> Iterator[tuple[Any, ...]]:
    """Return the blocks of a cell's episodes, by their `columns`."""
    if format_of(file) < FIRST_WITH_BLOCKS:
        return iter(())
    return file.execute(f"SELECT {', '.join(columns)} {_BLOCKS_OF_CELL}", (cell,))


def sizes_in(file: sqlite3.Connection, cell: int) -> Sizes:
    """Return the sizes of the episodes of a cell as a table."""
    if format_of(file) < FIRST_WITH_BLOCKS:
        return sizes_from(file, cell, _rows_of_cell(file))
    present = ", ".join(f"length({name})" for name in LAYOUT if name not in NULLABLE)
    episodes = f"max(min(episodes, {blocks.EPISODES}, coalesce(length(total_reward), 0) / 8, {present}), 1)"
    of_blocks = sizes_from(file, cell, _BLOCKS_OF_CELL, episodes, "max(decisions, 0)")
    return sizes_from(file, cell, _rows_of_cell(file)).joined(of_blocks)


def sizes_from(
    file: sqlite3.Connection, cell: int, source: str, episodes: str = "1", decisions: str = "length"
) -> Sizes:
    """Return the sizes of a part of a cell's episodes: of what `source` gives, the end of a query for rows or blocks.

    Either has so many `episodes` and `decisions`, by SQL, and no more than fit its other columns.
    """
    query = (
        f"SELECT coalesce(sum({episodes}), 0), coalesce(sum(length(reward_terms)) / 8, 0), "
        f"coalesce(sum(min({decisions}, length(decision_ms) / 2)), 0), "
        f"coalesce(max(length(decision_ms) / max({decisions}, 1)), 0) {source}"
    )
    return Sizes(*file.execute(query, (cell,)).fetchone())


def _rows_of_cell(file: sqlite3.Connection) -> str:
    """Return the end of a query for a cell: in the order of the file if that holds no others, else by the index."""
    is_single = file.execute("SELECT count(*) FROM cell").fetchone()[0] == 1
    return f"FROM {rows_table(format_of(file))} {'NOT INDEXED' if is_single else ''} WHERE cell = ?"


def origin_of(identity: Mapping[str, Any], texts: Sequence[str], is_strange: bool = False) -> Origin:
    """Return the properties that all episodes of a cell share. Those of a strange file must be possible ones."""
    keys = KEYS.validate_python(identity)
    policies = keys.policies if is_strange else None
    return Origin(Texts(texts), checksum_of(identity), bare_id(keys.env), keys.seed, policies)


def checksum_of(identity: Mapping[str, Any]) -> int:
    """Return the part of an episode's checksum that says to which cell it belongs."""
    return crc32(digest(identity).encode())
