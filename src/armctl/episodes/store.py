"""The one file of a results folder that is read back: an SQLite database, to which each episode is added as it ends.

It can hold several cells; so far, a comparison's folder holds one. Why it is as it is: `docs/decisions/store.md`.
"""

import contextlib
import itertools
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from pydantic import TypeAdapter

from armctl.core.errors import ResultsError
from armctl.core.files import digest, one_writer, sealed, unsealed, write_atomically
from armctl.core.registration import bare_id
from armctl.episodes.database import (
    APPLICATION,
    FORMAT,
    OTHERWISE,
    SCHEMA,
    check_file,
    connected,
    damage,
    files,
    reason,
)
from armctl.episodes.record import EpisodeResult
from armctl.episodes.rows import COLUMNS, Sizes, row_of, sizes_of, table_of_rows
from armctl.episodes.table import EpisodeTable
from armctl.runtime.identity import reasons_not_to_resume
from armctl.runtime.provenance import Run

STORE = "results.sqlite"
POLICY_SEED = "policy_seed"
"""In a comparison's identity: the secret of its policies' random numbers, in decimal digits."""
_CELL = 0
_INSERT = f"INSERT INTO episode VALUES ({', '.join('?' * (1 + len(COLUMNS)))})"
_SELECT = f"SELECT {', '.join(COLUMNS)} FROM episode NOT INDEXED WHERE cell = ?"
_RUNS = TypeAdapter(list[Run])


@dataclass(frozen=True)
class _Keys:
    """The part of a cell's identity that its episodes are checked by."""

    env: str
    seed: int
    policies: list[str]


_KEYS = TypeAdapter(_Keys)


class Stored(NamedTuple):
    """What a store holds of a cell."""

    identity: dict[str, Any]
    facts: dict[str, Any] | None
    """What is known besides the episodes; None while it is unfinished."""
    runs: list[Run]
    """Those that have played episodes, or told another verdict."""
    episodes: EpisodeTable


class EpisodeStore:
    """Writes the episodes of a cell to the store of a folder, each in a transaction of its own.

    `kept` are the episodes that an earlier run of the same comparison has finished. Until it is closed, no other
    process can write to the folder. Without a folder, everything is in memory.

    Raises `ResultsError` if the folder cannot be written, is damaged, is being written to by another process, or holds
    another comparison's results (unless `overwrite`).
    """

    def __init__(
        self,
        folder: Path | None,
        identity: Mapping[str, Any],
        episodes: int,
        overwrite: bool = False,
        run: Run | None = None,
    ) -> None:
        self._folder, self.identity = folder, dict(identity)
        self._texts: dict[str, int] = {}
        self._unwritten: list[tuple[Any, ...]] = []
        """Rows that could not be written."""
        self._failure: sqlite3.Error | None = None
        self._opened = contextlib.ExitStack()
        self.kept = EpisodeTable()
        self.runs: list[Run] = []
        """The runs of `kept`."""
        self._grown = False
        try:
            if folder is not None:
                self._opened.enter_context(one_writer(folder))
            path = None if folder is None else folder / STORE
            resuming = path is not None and not overwrite and os.path.lexists(path)
            if path is not None and not resuming:
                for part in files(path):
                    part.unlink(missing_ok=True)
                write_atomically(path, self._make)
            with damage(path) if path is not None else contextlib.nullcontext():
                self._file = self._opened.enter_context(connected(path, "rw"))
            if path is None:
                self._make_tables(self._file)
            elif resuming:
                self._resume(path, episodes)
            self._begin(run)
            self._cell_checksum = _checksum(self.identity)
        except (OSError, sqlite3.Error) as error:
            self.close()
            raise ResultsError(f"results cannot be written to {folder}: {reason(error)}") from error
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "EpisodeStore":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, result: EpisodeResult) -> None:
        """Add an episode. `finish` tells whether that failed; until then it is kept in memory."""
        num_texts, self._grown = len(self._texts), True
        row = row_of(result, self._texts, self._cell_checksum)
        if self._failure is None:
            new = (
                [(i, text) for text, i in self._texts.items() if i >= num_texts] if len(self._texts) > num_texts else []
            )
            try:
                with _transaction(self._file):
                    self._file.executemany("INSERT INTO text VALUES (?, ?)", new)
                    self._file.execute(_INSERT, (_CELL, *row))
                return
            except sqlite3.Error as error:
                self._failure = error
        self._unwritten.append(row)

    def episodes(self) -> EpisodeTable:
        """All episodes: those that were kept, and those that were added."""
        if not self._grown:
            return self.kept
        rows = itertools.chain(self._file.execute(_SELECT, (_CELL,)), self._unwritten)
        stored, unwritten = _sizes(self._file), sizes_of(self._unwritten)
        sizes = Sizes(*map(sum, zip(stored, unwritten, strict=True)))
        return _table(rows, sizes, [*self._texts], self.identity)

    def finish(self, facts: Mapping[str, Any], runs: Iterable[Run], without: Iterable[str] = ()) -> list[Run]:
        """Write what is known besides the episodes, with the `runs`, and remove the episodes of policies `without`.

        Returns the runs that count. Raises `ResultsError`, also if an episode could not be written; all others are
        there to be resumed.
        """
        try:
            if self._failure is not None:
                raise self._failure
            with _transaction(self._file):
                removed = [(self._texts.get(name),) for name in without]
                self._file.executemany("DELETE FROM episode WHERE policy = ?", removed)
                counted = self._write_runs(runs)
                self._file.execute("UPDATE cell SET facts = ?", (sealed(facts),))
            self._file.execute("PRAGMA journal_mode = DELETE")
            return counted
        except sqlite3.Error as error:
            raise ResultsError(
                f"{self._folder} could not be written any further ({reason(error)}): the same command resumes from "
                "the episodes that it holds"
            ) from error

    def close(self) -> None:
        """Close the file, and let others write to the folder."""
        self._opened.close()

    def _make(self, path: Path) -> None:
        with connected(path, "rw") as file:
            self._make_tables(file)

    def _make_tables(self, file: sqlite3.Connection) -> None:
        with _transaction(file):
            file.execute(f"PRAGMA application_id = {APPLICATION}")
            file.execute(f"PRAGMA user_version = {FORMAT}")
            for table in SCHEMA.values():
                file.execute(table)
            file.execute("INSERT INTO cell VALUES (?, ?, NULL)", (_CELL, sealed(self.identity)))

    def _resume(self, path: Path, episodes: int) -> None:
        with damage(path):
            check_file(self._file)
            identity, _ = _cell(self._file)
            if reasons := "; ".join(reasons_not_to_resume(identity, self.identity)):
                raise ResultsError(f"{self._folder} holds results of another comparison ({reasons}): {OTHERWISE}")
            self.identity = identity
            self.kept, self.runs = _episodes(self._file, identity), _runs(self._file)
            self._texts = {text: i for i, text in enumerate(_texts(self._file))}
        if (last := self.kept.column("episode").max(initial=0)) >= episodes:
            raise ResultsError(
                f"{self._folder} already holds episode {last}, beyond the {episodes} asked for: ask for more, choose "
                "another folder, or overwrite them (--overwrite)"
            )

    def _begin(self, run: Run | None) -> None:
        """Add a run, so that every episode's run is known."""
        self._file.execute("PRAGMA journal_mode = WAL")
        with _transaction(self._file):
            self._file.execute("UPDATE cell SET facts = NULL")
            self.runs = self._write_runs(self.runs)
            if run is not None:
                self._add_runs([run])

    def _write_runs(self, runs: Iterable[Run]) -> list[Run]:
        """Replace the runs by those that have played episodes, or told a verdict by other arguments than all before."""
        played = {text for (text,) in self._file.execute("SELECT text FROM text WHERE id IN (SELECT run FROM episode)")}
        counted: list[Run] = []
        for run in runs:
            verdicts = {(other.baseline, other.margin) for other in counted if other.judged}
            if run.id in played or (run.judged and (run.baseline, run.margin) not in verdicts):
                counted.append(run)
        self._file.execute("DELETE FROM run")
        self._add_runs(counted)
        return counted

    def _add_runs(self, runs: Iterable[Run]) -> None:
        self._file.executemany("INSERT INTO run VALUES (?, ?)", [(_CELL, sealed(asdict(run))) for run in runs])


@contextlib.contextmanager
def _transaction(file: sqlite3.Connection) -> Iterator[None]:
    file.execute("BEGIN IMMEDIATE")
    try:
        yield
        file.execute("COMMIT")
    except BaseException:
        if file.in_transaction:
            file.execute("ROLLBACK")
        raise


def read_store(folder: Path) -> Stored:
    """Read the store of a folder. Raises `ResultsError` if it is missing or damaged."""
    with _read(folder) as file:
        identity, facts = _cell(file)
        return Stored(identity, facts, _runs(file), _episodes(file, identity))


def read_identity(folder: Path) -> dict[str, Any]:
    """Read what identifies the comparison in a folder's store. Raises `ResultsError` if it is missing or damaged."""
    with _read(folder, whole=False) as file:
        return _cell(file)[0]


def stored_policy_seed(folder: Path) -> int | None:
    """The policy seed in a folder's store; None if there is none that can be read."""
    try:
        return int(read_identity(folder)[POLICY_SEED])
    except (ResultsError, LookupError, TypeError, ValueError):
        return None


@contextlib.contextmanager
def _read(folder: Path, whole: bool = True) -> Iterator[sqlite3.Connection]:
    """A folder's store, opened to be read: by itself, unless a run that was killed has left a log to recover from."""
    path = folder / STORE
    recovered = any(part.exists() and part.stat().st_size for part in files(path)[1:])
    with damage(path), connected(path, "rw" if recovered else "ro&immutable=1") as file:
        check_file(file, whole)
        yield file


def _cell(file: sqlite3.Connection) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """The identity of the one cell, and the facts of it."""
    ((number, identity, facts),) = file.execute("SELECT id, identity, facts FROM cell LIMIT 2")
    if number != _CELL:
        raise ValueError("it has another cell than that of a comparison")
    return unsealed(identity), None if facts is None else unsealed(facts)


def _runs(file: sqlite3.Connection) -> list[Run]:
    return _RUNS.validate_python([unsealed(record) for (record,) in file.execute("SELECT record FROM run")])


def _texts(file: sqlite3.Connection) -> list[str]:
    numbers, texts = [], []
    for number, text in file.execute("SELECT id, text FROM text ORDER BY id"):
        numbers.append(number)
        texts.append(text)
    if numbers != list(range(len(texts))) or len(set(texts)) != len(texts):
        raise ValueError("its texts are not numbered")
    return texts


def _episodes(file: sqlite3.Connection, identity: Mapping[str, Any]) -> EpisodeTable:
    """The episodes in a file that anybody may have written."""
    policies = _KEYS.validate_python(identity).policies
    table = _table(file.execute(_SELECT, (_CELL,)), _sizes(file), _texts(file), identity, policies)
    if (foreign := file.execute("SELECT count(*) FROM episode").fetchone()[0] - len(table)) != 0:
        raise ValueError(f"it has {foreign} episodes that are not of this comparison")
    if any(len(np.unique(part.column("episode"))) < len(part) for part in table.by_policy().values()):
        raise ValueError("it has an episode for the second time")
    return table


def _sizes(file: sqlite3.Connection) -> Sizes:
    count = "count(*), coalesce(sum(length(reward_terms)), 0) / 8, coalesce(sum(length(decision_ms)), 0) / 2"
    return Sizes(*file.execute(f"SELECT {count} FROM episode NOT INDEXED WHERE cell = ?", (_CELL,)).fetchone())


def _table(
    rows: Iterable[Sequence[Any]],
    sizes: Sizes,
    texts: Sequence[str],
    identity: Mapping[str, Any],
    policies: Sequence[str] | None = None,
) -> EpisodeTable:
    keys = _KEYS.validate_python(identity)
    return table_of_rows(rows, sizes, texts, _checksum(identity), bare_id(keys.env), keys.seed, policies)


def _checksum(identity: Mapping[str, Any]) -> int:
    return crc32(digest(identity).encode())
