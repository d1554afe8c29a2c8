"""Changes to a cell's episodes in the store: many rows become a block, and some episodes are removed."""

import contextlib
import sqlite3

import numpy as np
from numpy.typing import ArrayLike

from armctl.episodes import blocks
from armctl.episodes.blocks import BLOCK_COLUMNS, unpacked_numbers
from armctl.episodes.database import transaction
from armctl.episodes.rows import COLUMNS, Origin, columns_of_rows
from armctl.episodes.stored import blocks_in, sizes_from

LARGEST_LISTS = 2**27
"""Bytes that a block's rewards and decision times may take: half of what the store may hold in one value."""
INSERT_ROW, INSERT_BLOCK = (
    f"INSERT INTO {table} VALUES ({', '.join('?' * (1 + len(columns)))})"
    for table, columns in {"episode_row": COLUMNS, "episode_block": BLOCK_COLUMNS}.items()
)


def pack_rows(file: sqlite3.Connection, cell: int, origin: Origin) -> None:
    """Make a block of a cell's first rows. If there are too few or too large ones, or that fails, they stay rows."""
    source = f"FROM (SELECT rowid AS place, * FROM episode_row WHERE cell = ? ORDER BY rowid LIMIT {blocks.EPISODES})"
    with contextlib.suppress(sqlite3.Error, ValueError, IndexError, MemoryError), transaction(file):
        sizes = sizes_from(file, cell, source)
        if sizes.episodes < blocks.EPISODES or 8 * sizes.rewards + sizes.width * sizes.decisions > LARGEST_LISTS:
            return
        rows = file.execute(f"SELECT {', '.join(COLUMNS)} {source}", (cell,)).fetchall()
        columns = columns_of_rows(rows, origin, sizes.time_type)
        file.execute(INSERT_BLOCK, (cell, *blocks.block_of(columns, origin)))
        file.execute(f"DELETE FROM episode_row WHERE rowid IN (SELECT place {source})", (cell,))


def remove(file: sqlite3.Connection, cell: int, origin: Origin, name: str, values: ArrayLike) -> None:
    """Remove the episodes of a cell of which a column of whole numbers has one of some values."""
    numbers = np.asarray(values, np.int64)
    rows = [(cell, number) for number in numbers.tolist()]
    file.executemany(f"DELETE FROM episode_row WHERE cell = ? AND {name} = ?", rows)
    for (place,) in [*blocks_in(file, cell, ["rowid"])] if rows else []:
        query = f"SELECT {', '.join(BLOCK_COLUMNS)} FROM episode_block WHERE rowid = ?"
        block = file.execute(query, (place,)).fetchone()
        rest = blocks.block_without(block, name, numbers, origin)
        if rest is block:
            continue
        file.execute("DELETE FROM episode_block WHERE rowid = ?", (place,))
        if rest is not None:
            file.execute(INSERT_BLOCK, (cell, *rest))


def runs_with_episodes(file: sqlite3.Connection, cell: int) -> set[int]:
    """Return the runs of a cell's episodes, as numbers of texts."""
    runs = {number for (number,) in file.execute("SELECT DISTINCT run FROM episode_row WHERE cell = ?", (cell,))}
    for episodes, numbers in blocks_in(file, cell, ["episodes", "run"]):
        runs.update(np.unique(unpacked_numbers("run", numbers, episodes)).tolist())
    return runs
