"""Many episodes of a cell as one row of the store's table `episode_block`: an array for each column.

Reading a block makes no Python objects for each episode, unlike reading rows. Its checksum is of its values, its texts
and the identity of its cell.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from armctl.episodes.columns import Ragged
from armctl.episodes.rows import LAYOUT, NO_FIT, NULLABLE, NUMBERS, TEXTS, UNKNOWN, WRONG_TERMS, Origin, Sizes, as_type

EPISODES = 10_000
"""Episodes in a block; fewer if some of them were removed. Blocks with more are refused."""
BLOCK_COLUMNS = ("episodes", "decisions", *LAYOUT, "reward_terms", "decision_ms", "checksum")
"""Columns of the table, besides that of the cell."""
_CHANGED = "a block of episodes was changed, or belongs to another comparison"


def block_definition() -> str:
    """Return the columns of the table in SQL. A number that is unknown throughout is NULL."""
    numbers = ", ".join(f"{name} BLOB{'' if name in NULLABLE else ' NOT NULL'}" for name in LAYOUT)
    return (
        "episodes INTEGER NOT NULL, decisions INTEGER NOT NULL, "
        f"{numbers}, reward_terms BLOB NOT NULL, decision_ms BLOB NOT NULL, checksum INTEGER NOT NULL"
    )


def block_of(columns: Mapping[str, NDArray[Any]], origin: Origin) -> tuple[Any, ...]:
    """Return the block of some columns (see `columns_of_rows`)."""
    numbers = [_packed(columns[name]) for name in LAYOUT]
    counts = len(columns["episode"]), len(columns["decision_ms"])
    lists = [columns[name].tobytes() for name in ("reward_terms", "decision_ms")]
    blobs = [*numbers, *lists]
    return (*counts, *blobs, _checksum(columns, blobs, origin))


def columns_of_block(
    block: Sequence[Any], origin: Origin, time_type: "np.dtype[Any] | None" = None
) -> dict[str, NDArray[Any]]:
    """Return the columns of a block, as `columns_of_rows` does, and raise what it does.

    Without a `time_type`, decision times stay of their own type.
    """
    (episodes, decisions, *blobs, checksum), (rewards, times) = block, block[-3:-1]
    if not 1 <= episodes <= EPISODES:
        raise ValueError(_CHANGED)
    columns = {name: unpacked_numbers(name, blob, episodes) for name, blob in zip(LAYOUT, blobs[:-2], strict=True)}
    if _checksum(columns, blobs, origin) != checksum:
        raise ValueError(_CHANGED)
    lengths, own_type = columns["length"], Sizes(width=len(times) // max(decisions, 1)).time_type
    is_possible = lengths.min() >= 0 and lengths.max() <= decisions == lengths.sum()
    if not is_possible or len(times) != decisions * own_type.itemsize:
        raise ValueError(NO_FIT)
    if len(rewards) != 8 * origin.texts.num_terms(columns["terms"]).sum():
        raise ValueError(WRONG_TERMS)
    columns["reward_terms"] = np.frombuffer(rewards, "<f8")
    columns["decision_ms"] = as_type(np.frombuffer(times, own_type), time_type or own_type)
    return columns


def block_without(block: Sequence[Any], column: str, values: NDArray[np.int64], origin: Origin) -> Sequence[Any] | None:
    """Return a block without the episodes of which a column has one of some values; None if it has no others."""
    columns = columns_of_block(block, origin)
    rows = np.flatnonzero(~np.isin(columns[column], values))
    if len(rows) in (0, len(columns[column])):
        return block if len(rows) else None
    lengths = {"reward_terms": origin.texts.num_terms(columns["terms"]), "decision_ms": columns["length"]}
    rest = {
        name: Ragged.of(numbers, lengths[name]).take(rows).values if name in lengths else numbers[rows]
        for name, numbers in columns.items()
    }
    return block_of(rest, origin)


def _packed(values: NDArray[Any]) -> bytes | None:
    """Numbers in as few bytes as hold all of them; None if all are unknown."""
    if values.dtype.kind == "f":
        return None if np.isnan(values).all() else values.astype("<f8").tobytes()
    if (values == UNKNOWN).all():
        return None
    kinds = (np.dtype(f"<i{width}") for width in (1, 2, 4, 8))
    kind = next(kind for kind in kinds if np.iinfo(kind).min <= values.min() and values.max() <= np.iinfo(kind).max)
    return values.astype(kind).tobytes()


def unpacked_numbers(name: str, packed: bytes | None, count: int) -> NDArray[Any]:
    """Return a column of so many numbers. Raises `ValueError`."""
    unknown, kind, widths = (np.nan, "f", (8,)) if name in NUMBERS else (UNKNOWN, "i", (1, 2, 4, 8))
    if packed is None:
        return np.full(count, unknown)
    width, rest = divmod(len(packed), count)
    if rest or width not in widths:
        raise ValueError(_CHANGED)
    return np.frombuffer(packed, f"<{kind}{width}").astype(f"<{kind}8")


def _checksum(columns: Mapping[str, NDArray[Any]], blobs: Sequence[bytes | None], origin: Origin) -> int:
    """Checksum of a block's texts, and of its blobs and their sizes."""
    texts = [origin.texts.checksums(columns[name]).tobytes() for name in TEXTS]
    sizes = struct.pack(f"<{len(blobs)}q", *(-1 if blob is None else len(blob) for blob in blobs))
    checksum = origin.checksum
    for part in (*texts, sizes, *blobs):
        checksum = crc32(part or b"", checksum)
    return checksum
