"""The one file of a results folder that is read back: an SQLite database, to which each episode is added as it ends.

It holds the cells of a study. Why it is as it is: `docs/decisions/store.md`.
"""

import contextlib
import itertools
import os
import sqlite3
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.errors import ResultsError
from armctl.core.files import one_writer, sealed, unsealed, write_atomically
from armctl.episodes import blocks
from armctl.episodes.database import (
    APPLICATION,
    FORMAT,
    check_file,
    connected,
    damage,
    files,
    format_of,
    reason,
    schema,
    transaction,
    undo_open,
)
from armctl.episodes.packing import INSERT_ROW, pack_rows, remove, runs_with_episodes
from armctl.episodes.record import EpisodeResult
from armctl.episodes.rows import Origin, row_of
from armctl.episodes.stored import (
    KEYS,
    STORE,
    cells_in,
    checksum_of,
    episodes_in,
    episodes_of,
    judged_runs,
    origin_of,
    runs_of,
    texts_in,
)
from armctl.episodes.table import EpisodeTable
from armctl.runtime.folder import OTHERWISE, refuse_changes
from armctl.runtime.identity import reasons_not_to_resume
from armctl.runtime.provenance import Run

_COUNT_ROWS = "SELECT count(*) FROM episode_row WHERE cell = ?"
OTHER_RESULTS = "results of another comparison"


class Store:
    """Writes a study to a folder, each episode in a transaction of its own.

    The folder is made, and kept from other processes, with the first cell. Without a folder, everything is in memory.
    """

    def __init__(self, folder: Path | None, overwrite: bool = False) -> None:
        self.folder, self._overwrite = folder, overwrite
        self.texts: dict[str, int] = {}
        self.num_texts_written = 0
        """Texts that are surely in the file: there are more after an interrupted write."""
        self.failure: sqlite3.Error | None = None
        """Why episodes cannot be written any more."""
        self._overwritten: list[tuple[dict[str, Any], list[Run]]] = []
        """Identities of overwritten cells, and what was told of them."""
        self._opened = contextlib.ExitStack()
        self._file: sqlite3.Connection | None = None

    def __enter__(self) -> "Store":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def open(self, seed: int, cells: Collection[str]) -> None:
        """Open the file, or make it, for a study of these `cells` and this seed.

        Raises `ResultsError` if the folder cannot be written, is damaged, is being written to by another process, or
        holds other cells, or results of another seed (unless `overwrite`).
        """
        if self._file is not None:
            return
        path = None if self.folder is None else self.folder / STORE
        with self._writing():
            if self.folder is not None and path is not None:
                self._opened.enter_context(one_writer(self.folder))
                if self._overwrite or not os.path.lexists(path):
                    self._overwritten = judged_runs(self.folder)
                    for part in files(path):
                        part.unlink(missing_ok=True)
                    write_atomically(path, _make)
            with damage(path) if path is not None else contextlib.nullcontext():
                file = self._opened.enter_context(connected(path, "rw"))
                if path is None:
                    _make_tables(file)
                else:
                    check_file(file)
                    self._refuse_older(format_of(file))
                    self.texts = {text: i for i, text in enumerate(texts_in(file))}
                    self.num_texts_written = len(self.texts)
                stored_seeds = {KEYS.validate_python(unsealed(text)).seed for _, _, text, _ in cells_in(file)}
                further = [name for _, name, *_ in cells_in(file) if name not in cells]
            changes = [f"seed: {other} there, {seed} here" for other in stored_seeds - {seed}]
            refuse_changes(self.folder or Path(), changes, OTHER_RESULTS)
            if further:
                raise ResultsError(
                    f"{self.folder} holds further results ({', '.join(further)}): ask for these too, {OTHERWISE}"
                )
            self._file = file

    def _refuse_older(self, number: int) -> None:
        if number != FORMAT:
            raise ResultsError(
                f"{self.folder} holds results of format {number}, which can be read, but not added to: {OTHERWISE}"
            )

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            self.close()
            raise ResultsError(f"results cannot be written to {self.folder}: {reason(error)}") from error
        except BaseException:
            self.close()
            raise

    def overwritten_runs(self, identity: Mapping[str, Any]) -> list[Run]:
        """Return the overwritten runs that told a verdict on these policies, or on two of them, in these episodes."""
        policies, same = set(identity["policies"]), ("env", "env_options", "seed")
        return [
            run
            for other, runs in self._overwritten
            if all(other.get(name) == identity.get(name) for name in same)
            and len(policies.intersection(other.get("policies", ()))) >= min(2, len(policies))
            for run in runs
        ]

    @property
    def file(self) -> sqlite3.Connection:
        """The open file."""
        assert self._file is not None
        return self._file

    def cell(self, name: str, identity: Mapping[str, Any], episodes: int, run: Run | None = None) -> "CellWriter":
        """Begin or resume a cell of at most so many episodes of each policy.

        Raises `ResultsError` if the cell holds another comparison's results, or more episodes, or is damaged.
        """
        try:
            return CellWriter(self, name, dict(identity), episodes, run)
        except (OSError, sqlite3.Error) as error:
            raise ResultsError(f"results cannot be written to {self.folder}: {reason(error)}") from error

    def describe(self, record: Mapping[str, Any]) -> None:
        """Write what was played, and what came of it. Raises `ResultsError`."""
        with self.full_disk(), transaction(self.file):
            self.file.execute("DELETE FROM study")
            self.file.execute("INSERT INTO study VALUES (?)", (sealed(record),))

    @contextlib.contextmanager
    def full_disk(self) -> Iterator[None]:
        """Raise `ResultsError` if something cannot be written, or an earlier episode could not be."""
        try:
            if self.failure is not None:
                raise self.failure
            yield
        except sqlite3.Error as error:
            raise ResultsError(
                f"{self.folder} could not be written any further ({reason(error)}): the same command resumes from "
                "the episodes that it holds"
            ) from error

    def close(self) -> None:
        """Make one file of the log and the database, if it can be written, and let others write to the folder."""
        if self._file is not None:
            with contextlib.suppress(sqlite3.Error):
                if self._file.execute("PRAGMA journal_mode").fetchone()[0] == "wal":
                    self._file.execute("PRAGMA journal_mode = DELETE")
        self._file = None
        self._opened.close()


class CellWriter:
    """Writes the episodes of a cell. `kept` are those that an earlier run has finished, and `runs` their runs."""

    def __init__(self, store: Store, name: str, identity: dict[str, Any], episodes: int, run: Run | None) -> None:
        self._store, self.identity = store, identity
        self._unwritten: list[tuple[Any, ...]] = []
        """Rows that could not be written."""
        self.kept = EpisodeTable()
        self.runs = store.overwritten_runs(identity)
        self._grown, self._num_rows = False, 0
        """Rows are counted since the last time that a block was tried."""
        present = {stored: (number, text) for number, stored, text, _ in cells_in(store.file)}
        self._number = present[name][0] if name in present else max((i for i, _ in present.values()), default=-1) + 1
        if name in present:
            self._resume(present[name][1], episodes)
        self._checksum = checksum_of(self.identity)
        store.file.execute("PRAGMA journal_mode = WAL")
        with transaction(store.file):
            if name in present:
                store.file.execute("UPDATE cell SET facts = NULL WHERE id = ?", (self._number,))
            else:
                store.file.execute(
                    "INSERT INTO cell VALUES (?, ?, ?, NULL)", (self._number, name, sealed(self.identity))
                )
            self.runs = self._write_runs(self.runs)
            if run is not None:
                self._add_runs([run])

    def forget(self, episodes: NDArray[np.int64]) -> None:
        """Remove episodes that were kept, by their numbers. Raises `ResultsError`."""
        if len(episodes):
            with self._store.full_disk(), transaction(self._store.file):
                self._remove("episode", episodes)
            self.kept = self.kept[~np.isin(self.kept.column("episode"), episodes)]

    def write(self, result: EpisodeResult) -> None:
        """Add an episode. `finish` tells whether that failed; until then it is kept in memory."""
        store, self._grown = self._store, True
        row = row_of(result, store.texts, self._checksum)
        if store.failure is None:
            new = [(i, text) for text, i in itertools.islice(store.texts.items(), store.num_texts_written, None)]
            try:
                with transaction(store.file):
                    store.file.executemany("INSERT OR IGNORE INTO text VALUES (?, ?)", new)
                    store.file.execute(INSERT_ROW, (self._number, *row))
                store.num_texts_written = len(store.texts)
                self._num_rows += 1
            except sqlite3.Error as error:
                store.failure = error
        if store.failure is not None:
            self._unwritten.append(row)
        elif self._num_rows >= blocks.EPISODES:
            self._num_rows = 0
            pack_rows(store.file, self._number, self._origin)

    def episodes(self) -> EpisodeTable:
        """All episodes: those that were kept, and those that were added."""
        if not self._grown:
            return self.kept
        undo_open(self._store.file)
        return episodes_in(self._store.file, self._number, self._origin, self._unwritten)

    def finish(self, facts: Mapping[str, Any], runs: Iterable[Run], without: Iterable[str] = ()) -> list[Run]:
        """Write what is known besides the episodes, with the `runs`, and remove the episodes of policies `without`.

        Returns the runs that count. Raises `ResultsError`, also if an episode could not be written; all others are
        there to be resumed.
        """
        file = self._store.file
        with self._store.full_disk(), transaction(file):
            self._remove("policy", [self._store.texts[name] for name in without if name in self._store.texts])
            counted = self._write_runs(runs)
            file.execute("UPDATE cell SET facts = ? WHERE id = ?", (sealed(facts), self._number))
        return counted

    @property
    def _origin(self) -> Origin:
        return origin_of(self.identity, [*self._store.texts])

    def _remove(self, name: str, values: ArrayLike) -> None:
        remove(self._store.file, self._number, self._origin, name, values)

    def _resume(self, identity_text: str, episodes: int) -> None:
        store = self._store
        with damage((store.folder or Path()) / STORE):
            identity = unsealed(identity_text)
            refuse_changes(store.folder or Path(), reasons_not_to_resume(identity, self.identity), OTHER_RESULTS)
            self.identity = identity
            self.kept = episodes_of(store.file, self._number, identity, [*store.texts])
            self.runs = runs_of(store.file, self._number)
            self._num_rows = store.file.execute(_COUNT_ROWS, (self._number,)).fetchone()[0]
        if (last := self.kept.column("episode").max(initial=0)) >= episodes:
            raise ResultsError(
                f"{store.folder} already holds episode {last}, beyond the {episodes} asked for: ask for more, "
                f"{OTHERWISE}"
            )

    def _write_runs(self, runs: Iterable[Run]) -> list[Run]:
        """Replace the runs by those that have played episodes, or told a verdict by other arguments than all before.

        Overwritten ones stay.
        """
        texts = [*self._store.texts]
        ids = {texts[i] for i in runs_with_episodes(self._store.file, self._number)}
        counted: list[Run] = []
        for run in runs:
            verdicts = {(other.baseline, other.margin) for other in counted if other.judged}
            is_new_verdict = run.judged and (run.baseline, run.margin) not in verdicts
            if run.overwritten or run.id in ids or is_new_verdict:
                counted.append(run)
        self._store.file.execute("DELETE FROM run WHERE cell = ?", (self._number,))
        self._add_runs(counted)
        return counted

    def _add_runs(self, runs: Iterable[Run]) -> None:
        records = [(self._number, sealed(asdict(run))) for run in runs]
        self._store.file.executemany("INSERT INTO run VALUES (?, ?)", records)


def _make(path: Path) -> None:
    with connected(path, "rw") as file:
        _make_tables(file)


def _make_tables(file: sqlite3.Connection) -> None:
    with transaction(file):
        file.execute(f"PRAGMA application_id = {APPLICATION}")
        file.execute(f"PRAGMA user_version = {FORMAT}")
        for table in schema().values():
            file.execute(table)
