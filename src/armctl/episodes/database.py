"""The SQLite database of a results folder: its tables, and how it is opened. It may come from a stranger."""

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from armctl.core.errors import ResultsError
from armctl.core.files import check_format, opened_regular
from armctl.episodes.blocks import block_definition
from armctl.episodes.rows import NUMBERS, NUMBERS_OF_FORMAT_1, definition
from armctl.runtime.folder import OTHERWISE

LARGEST_FILE, LARGEST_VALUE = 4 * 2**30, 2**28
"""Bytes of a store, and of a text, the decision times of an episode or a block in it."""
FORMAT = 3
"""Number of the layout, in the file's header. Files of formats 1, without measures of jerk, and 2 are read."""
FIRST_WITH_BLOCKS = 3
"""Format from which on episodes are in rows and blocks, and not in rows of a table `episode`."""
APPLICATION = 0x61726D63
"""The letters "armc", in the file's header."""
_TABLES = {
    "study": "record TEXT NOT NULL",
    "cell": "id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, identity TEXT NOT NULL, facts TEXT",
    "run": "cell INTEGER NOT NULL, record TEXT NOT NULL",
    "text": "id INTEGER PRIMARY KEY, text TEXT NOT NULL",
}


def rows_table(number: int = FORMAT) -> str:
    """Return the name of the table with a row for each episode, in files of a format."""
    return "episode_row" if number >= FIRST_WITH_BLOCKS else "episode"


def schema(number: int = FORMAT) -> dict[str, str]:
    """Return the SQL that makes each table of a format."""
    numbers = NUMBERS_OF_FORMAT_1 if number == 1 else NUMBERS
    tables = {rows_table(number): f"cell INTEGER NOT NULL, {definition(numbers)}, UNIQUE (cell, policy, episode)"}
    if number >= FIRST_WITH_BLOCKS:
        tables["episode_block"] = f"cell INTEGER NOT NULL, {block_definition()}"
    return {name: f"CREATE TABLE {name} ({columns}) STRICT" for name, columns in (_TABLES | tables).items()}


@contextlib.contextmanager
def connected(path: Path | None, mode: str) -> Iterator[sqlite3.Connection]:
    """Open a database, in memory if there is no path.

    Raises `OSError`, `ValueError`, `ResultsError` or `sqlite3.Error`.
    """
    name = ":memory:"
    if path is not None:
        for part in files(path):
            if part.is_symlink():
                raise ResultsError(f"{part} is a symbolic link, which may lead elsewhere: {OTHERWISE}")
            if part.exists():
                with opened_regular(part, LARGEST_FILE):
                    pass
        name = f"file:{quote(os.fsencode(os.path.abspath(path)))}?mode={mode}"
    file = sqlite3.connect(name, uri=True, isolation_level=None, timeout=0)
    with contextlib.closing(file):
        file.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_VALUE)
        settings = {"trusted_schema": "OFF", "cell_size_check": "ON", "synchronous": "NORMAL"}
        for setting, value in (settings | {"locking_mode": "EXCLUSIVE"}).items():
            file.execute(f"PRAGMA {setting} = {value}")
        yield file


@contextlib.contextmanager
def damage(path: Path) -> Iterator[None]:
    """Raise `ResultsError` for what goes wrong while a database is read."""
    try:
        yield
    except FileNotFoundError as error:
        raise ResultsError(f"{path} cannot be read: {error.strerror}") from error
    except (OSError, sqlite3.Error, ValueError, LookupError, TypeError, OverflowError, RecursionError) as error:
        if getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_BUSY:
            raise ResultsError(f"another process writes to {path.parent}: wait until it has finished") from error
        raise ResultsError(f"{path} is damaged ({reason(error)}): remove it, or overwrite all (--overwrite)") from error
    except MemoryError as error:
        raise ResultsError(f"{path} takes more memory than there is") from error


def format_of(file: sqlite3.Connection) -> int:
    """Return the number of a database's layout."""
    return int(file.execute("PRAGMA user_version").fetchone()[0])


def check_file(file: sqlite3.Connection, whole: bool = True) -> None:
    """Raise `ValueError` or `sqlite3.Error` unless a database is a sound one of our own."""
    if (number := format_of(file)) not in range(1, FORMAT):
        check_format({"format": number}, FORMAT)
    tables = schema(number)
    entries = file.execute("SELECT type, name, sql FROM sqlite_schema WHERE sql IS NOT NULL")
    if sorted(entries) != sorted(("table", name, sql) for name, sql in tables.items()):
        raise ValueError("it does not have the tables of armctl's results")
    if not whole:
        return
    if (message := file.execute("PRAGMA integrity_check(1)").fetchone()[0]) != "ok":
        raise ValueError(message)
    for table in tables.keys() - _TABLES.keys():
        foreign = f"SELECT count(*) FROM {table} WHERE cell NOT IN (SELECT id FROM cell)"
        if count := file.execute(foreign).fetchone()[0]:
            raise ValueError(f"its table {table} has {count} rows of other cells")


def files(path: Path) -> list[Path]:
    """Return the database's path, and those of the files beside it while it is written."""
    return [path.with_name(path.name + end) for end in ("", "-wal", "-journal", "-shm")]


def reason(error: Exception) -> str:
    """Return why a file could not be read or written."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


@contextlib.contextmanager
def transaction(file: sqlite3.Connection) -> Iterator[None]:
    """Write everything or nothing."""
    undo_open(file)
    file.execute("BEGIN IMMEDIATE")
    try:
        yield
        file.execute("COMMIT")
    except BaseException:
        undo_open(file)
        raise


def undo_open(file: sqlite3.Connection) -> None:
    """Undo a transaction that is open, as an interrupt may leave it."""
    if file.in_transaction:
        file.execute("ROLLBACK")
