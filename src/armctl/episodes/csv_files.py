"""Episodes as two CSV tables, to which each is added as it ends: the episodes, and the times of their decisions."""

import contextlib
import csv
import io
import itertools
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from armctl.core.errors import ResultsError
from armctl.core.files import digest, open_without_links, opened_regular, write_atomically
from armctl.core.registration import bare_id
from armctl.episodes.record import ADDED, COLUMNS, EpisodeResult
from armctl.episodes.table import EpisodeTable

DECISION_COLUMNS = ("policy", "episode", "checksum", "decision_ms")
"""The last column holds the episode's decision times, ms, separated by spaces. The checksum is of these, of the row in
`episodes.csv`, and of the comparison's identity."""
VERSIONS = [tuple(name for name in COLUMNS if name not in ADDED[i:]) for i in reversed(range(len(ADDED) + 1))]
"""Columns of `episodes.csv`: those of this version, and those of older ones."""
LARGEST_TABLE, LARGEST_FIELD = 4 * 2**30, 2**28
"""Bytes of a table, and of the decision times of one episode."""


class Journal:
    """Both tables, opened to add episodes. `own` is the digest of the comparison's identity."""

    def __init__(self, episodes: Path, decisions: Path, own: str) -> None:
        self._own = own
        self._opened = contextlib.ExitStack()
        with self._opened:
            self._files = [self._opened.enter_context(_appended(path)) for path in (decisions, episodes)]
            self._opened = self._opened.pop_all()

    def write(self, result: EpisodeResult) -> None:
        """Add an episode, and flush it to the operating system. Raises `OSError`."""
        self._write(_rows_of(result, self._own))

    def restart(self) -> None:
        """Remove all rows. Raises `OSError`."""
        for file in self._files:
            file.truncate(0)
        self._write((DECISION_COLUMNS, COLUMNS))

    def close(self) -> None:
        """Close the files."""
        self._opened.close()

    def _write(self, rows: Iterable[Iterable[Any]]) -> None:
        for file, row in zip(self._files, rows, strict=True):
            file.write(lines([row]))
            file.flush()


def write_csv(episodes: Path, decisions: Path, own: str, results: Iterable[EpisodeResult]) -> None:
    """Replace both tables by these results. Raises `OSError`."""

    def write(one_path: Path, other_path: Path) -> None:
        with _written(one_path) as one, _written(other_path) as other:
            tables = [csv.writer(file, lineterminator="\n") for file in (one, other)]
            for rows in itertools.chain([(DECISION_COLUMNS, COLUMNS)], (_rows_of(result, own) for result in results)):
                for table, row in zip(tables, rows, strict=True):
                    table.writerow(row)

    write_atomically(episodes, lambda other: write_atomically(decisions, lambda one: write(one, other)))


def read_csv(episodes: Path, decisions: Path, comparison: Mapping[str, Any], kept: EpisodeTable) -> None:
    """Add the finished episodes in both tables to `kept`, in file order. Raises `ResultsError` for damaged files."""
    own = digest(comparison)
    unknown = {"run": "", "reset_ms": "nan"}  # of episodes of an older version
    times = _DecisionRows(decisions)
    known: dict[str, set[str]] = defaultdict(set)
    for line, row in _rows(episodes, *VERSIONS):
        with _damage(episodes, line):
            if row["episode"] in known[row["policy"]]:
                raise ValueError(f"episode {row['episode']} of {row['policy']} for the second time")
            if (timed := times.of(row["policy"], row["episode"])) is None:
                continue
            spent = timed["decision_ms"]
            if timed["checksum"] != row_checksum(own, row.values(), spent):
                raise ValueError(f"it, or its line in {decisions.name}, was changed, or belongs to another comparison")
            result = EpisodeResult.from_row(unknown | row, np.array(spent.split(), dtype=float))
            expected = bare_id(comparison["env"]), comparison["seed"], len(result.decision_ms)
            if (result.env, result.seed, result.length) != expected or result.policy not in comparison["policies"]:
                raise ValueError("not an episode of this comparison")
            if result.episode < 0:
                raise ValueError(f"{result.episode} is not the number of an episode")
            kept.append(result)
        known[row["policy"]].add(row["episode"])
    times.finish()


class _DecisionRows:
    """The rows of `decisions.csv`, which are read as they are asked for: both tables should have the same order."""

    def __init__(self, path: Path) -> None:
        self._rows = _rows(path, DECISION_COLUMNS)
        self._ahead: dict[tuple[str, str], dict[str, str]] = {}
        """What was read and not asked for yet, by policy and episode."""

    def of(self, policy: str, episode: str) -> dict[str, str] | None:
        """The row of an episode, which is given once; None if there is none."""
        wanted = policy, episode
        while wanted not in self._ahead:
            if (row := next(self._rows, (0, None))[1]) is None:
                return None
            self._ahead[row["policy"], row["episode"]] = row
        return self._ahead.pop(wanted)

    def finish(self) -> None:
        """Read the rest, for it may be damaged."""
        for _ in self._rows:
            pass


@contextlib.contextmanager
def _damage(path: Path, line: int) -> Iterator[None]:
    try:
        yield
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise ResultsError(
            f"{path} is damaged in line {line} ({error}): repair or remove the line, or overwrite all (--overwrite)"
        ) from error


def _rows(path: Path, columns: tuple[str, ...], *older: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    """The lines of a table, by number, without an incomplete last one. Its columns may be those of `older` versions."""
    csv.field_size_limit(LARGEST_FIELD)
    try:
        with opened_regular(path, LARGEST_TABLE) as file:
            read = csv.reader(line.decode() for line in file if line.endswith(b"\n"))
            for line, values in enumerate(read, start=1):
                if line == 1 and tuple(values) in older:
                    columns = tuple(values)
                if len(values) != len(columns) or (line == 1 and tuple(values) != columns):
                    raise csv.Error(f"it does not have the columns {', '.join(columns)}")
                if line > 1:
                    yield line, dict(zip(columns, values, strict=True))
    except csv.Error as error:
        raise ResultsError(f"{path} is damaged in line {read.line_num}: {error}") from error
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} cannot be read: {error}; overwrite all (--overwrite)") from error


def _rows_of(result: EpisodeResult, own: str) -> tuple[Sequence[Any], Sequence[Any]]:
    """An episode's rows in both tables: that of its decisions first, without which the other does not count."""
    row, times = list(result.row().values()), " ".join(map(str, result.decision_ms.tolist()))
    return (result.policy, result.episode, row_checksum(own, row, times), times), row


def row_checksum(own: str, row: Iterable[Any], times: str) -> str:
    """The checksum of an episode's rows in both tables, and of the identity's digest."""
    return f"{zlib.crc32((own + lines([row]) + times).encode()):08x}"


def lines(rows: Iterable[Iterable[Any]]) -> str:
    """Rows as CSV text."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _written(path: Path) -> IO[str]:
    return path.open("w", newline="", encoding="utf-8")


@contextlib.contextmanager
def _appended(path: Path) -> Iterator[IO[str]]:
    file = open(path, "a", newline="", encoding="utf-8", opener=open_without_links)  # noqa: SIM115
    try:
        yield file
    finally:
        with contextlib.suppress(OSError):  # `EpisodeLog.finish` tells of a full disk
            file.close()
