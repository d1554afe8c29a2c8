"""The SQLite database of a results folder: its tables, and how it is opened. It may come from a stranger."""

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

from armctl.core.errors import ResultsError
from armctl.core.files import check_format, opened_regular
from armctl.episodes.rows import NUMBERS_OF_FORMAT_1, definition
from armctl.runtime.folder import OTHERWISE

LARGEST_FILE, LARGEST_VALUE = 4 * 2**30, 2**28
"""Bytes of a store, and of a text or the decision times of an episode in it."""
FORMAT = 2
"""Number of the layout, in the file's header. Files of format 1 are read: in them, no jerk was measured."""
APPLICATION = 0x61726D63
"""The letters "armc", in the file's header."""
_TABLES = {
    "study": "record TEXT NOT NULL",
    "cell": "id INTEGER PRIMARY KEY, name TEXT NOT NULL UNIQUE, identity TEXT NOT NULL, facts TEXT",
    "run": "cell INTEGER NOT NULL, record TEXT NOT NULL",
    "text": "id INTEGER PRIMARY KEY, text TEXT NOT NULL",
    "episode": f"cell INTEGER NOT NULL, {definition()}, UNIQUE (cell, policy, episode)",
}
SCHEMA = {name: f"CREATE TABLE {name} ({columns}) STRICT" for name, columns in _TABLES.items()}
_SCHEMA_OF_FORMAT_1 = SCHEMA | {"episode": SCHEMA["episode"].replace(definition(), definition(NUMBERS_OF_FORMAT_1))}


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


def format_of(file: sqlite3.Connection) -> int:
    """Return the number of a database's layout."""
    return int(file.execute("PRAGMA user_version").fetchone()[0])


def check_file(file: sqlite3.Connection, whole: bool = True) -> None:
    """Raise `ValueError` or `sqlite3.Error` unless a database is a sound one of our own."""
    if (number := format_of(file)) != 1:
        check_format({"format": number}, FORMAT)
    schema = file.execute("SELECT name, sql FROM sqlite_schema WHERE sql IS NOT NULL").fetchall()
    if dict(schema) != (_SCHEMA_OF_FORMAT_1 if number == 1 else SCHEMA):
        raise ValueError("it does not have the tables of armctl's results")
    if not whole:
        return
    if (message := file.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
        raise ValueError(message)
    foreign = "SELECT count(*) FROM episode WHERE cell NOT IN (SELECT id FROM cell)"
    if count := file.execute(foreign).fetchone()[0]:
        raise ValueError(f"it has {count} episodes that are not of its cells")


def files(path: Path) -> list[Path]:
    """Return the database's path, and those of the files beside it while it is written."""
    return [path.with_name(path.name + end) for end in ("", "-wal", "-journal", "-shm")]


def reason(error: Exception) -> str:
    """Return why a file could not be read or written."""
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
