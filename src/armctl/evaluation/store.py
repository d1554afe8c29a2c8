"""A comparison's folder. Every episode is written as it ends, so that an interrupted comparison can be resumed."""

import contextlib
import csv
import io
import itertools
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from pydantic import TypeAdapter

from armctl.errors import ResultsError
from armctl.evaluation.episode_table import EpisodeTable, table_of
from armctl.evaluation.identity import differences
from armctl.evaluation.provenance import Run
from armctl.evaluation.record import COLUMNS, EpisodeResult
from armctl.files import (
    bounded_text,
    digest,
    one_writer,
    open_without_links,
    opened_regular,
    sealed,
    unsealed,
    write_atomically,
)
from armctl.registration import bare_id

COMPARISON, EPISODES, DECISIONS, SUMMARY = "comparison.json", "episodes.csv", "decisions.csv", "summary.json"
RUNS = "runs.json"
"""The runs that have played episodes (see `Run`) or told another verdict, the present one included."""
DECISION_COLUMNS = ("policy", "episode", "checksum", "decision_ms")
"""The last column holds the episode's decision times, ms, separated by spaces. The checksum is of these, of the row in
`episodes.csv`, and of the comparison's identity."""
_RUNS = TypeAdapter(list[Run])
LARGEST_TABLE, LARGEST_FIELD = 4 * 2**30, 2**28
"""Bytes of a table, and of the decision times of one episode."""


class EpisodeLog:
    """Writes `comparison.json`, which identifies the comparison, and episodes to `decisions.csv` and `episodes.csv`.

    `kept` are the episodes that an earlier run of the same comparison has finished, except for an incomplete last line
    and for episodes without decision times. Until it is closed, no other process can write to the folder. Changed
    rows, and rows of another comparison, are noticed by their checksums.

    Raises `ResultsError` if the folder cannot be written, is damaged, is being written to by another process, or holds
    another comparison's results (unless `overwrite`).
    """

    def __init__(
        self,
        folder: Path,
        comparison: Mapping[str, Any],
        episodes: int,
        overwrite: bool = False,
        run: Run | None = None,
    ) -> None:
        self._own = digest(comparison)
        self.runs: list[Run] = []
        """The runs of `kept`, as far as they are known."""
        self._folder = folder
        self._opened = contextlib.ExitStack()
        self._failure: OSError | None = None
        try:
            self._opened.enter_context(one_writer(folder))
            resuming = (folder / EPISODES).exists() and not overwrite
            self.kept = self._read(comparison, episodes) if resuming else EpisodeTable()
            self.runs = _of(self.kept, read_runs(folder)) if resuming else []
            (folder / SUMMARY).unlink(missing_ok=True)
            if not resuming:
                for name in (EPISODES, DECISIONS):  # first, so that no row is ever beside another identity
                    (folder / name).unlink(missing_ok=True)
                write_atomically(folder / COMPARISON, sealed(comparison))
            self._write_runs([*self.runs, *([run] if run else [])])  # first, so that every row's run is known
            self._rewrite(self.kept)
            self._files = [self._opened.enter_context(_appended(folder / name)) for name in (DECISIONS, EPISODES)]
        except OSError as error:
            self.close()
            raise ResultsError(f"results cannot be written to {folder}: {error.strerror}") from error
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "EpisodeLog":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, result: EpisodeResult) -> None:
        """Append an episode, and flush it to the operating system. `finish` tells whether that failed."""
        if self._failure is not None:
            return
        try:
            for file, row in zip(self._files, self._rows(result), strict=True):
                file.write(_lines([row]))
                file.flush()
        except OSError as error:
            self._failure = error

    def finish(self, results: Sequence[EpisodeResult], summary: Mapping[str, Any], runs: Sequence[Run] = ()) -> None:
        """Replace all rows by these, in this order, and write `summary.json`, and the `runs` that played them.

        Raises `ResultsError`, also if an episode could not be written; the folder then holds those before.
        """
        try:
            if self._failure is not None:
                raise self._failure
            played = _of(results, runs)
            self._write_runs(played)
            self._rewrite(results)
            about = {**summary, "runs": [asdict(one) for one in played], "comparison": self._own}
            write_atomically(self._folder / SUMMARY, sealed(about))
        except OSError as error:
            raise ResultsError(
                f"{self._folder} could not be written any further ({error.strerror}): the same command resumes from "
                "the episodes that it holds"
            ) from error

    def close(self) -> None:
        """Close the files, and let others write to the folder."""
        self._opened.close()

    def _rewrite(self, results: Iterable[EpisodeResult]) -> None:
        def write(decisions: Path, episodes: Path) -> None:
            with _written(decisions) as one, _written(episodes) as other:
                tables = [csv.writer(file, lineterminator="\n") for file in (one, other)]
                for rows in itertools.chain([(DECISION_COLUMNS, COLUMNS)], map(self._rows, results)):
                    for table, row in zip(tables, rows, strict=True):
                        table.writerow(row)

        write_atomically(
            self._folder / EPISODES,
            lambda episodes: write_atomically(self._folder / DECISIONS, lambda decisions: write(decisions, episodes)),
        )

    def _write_runs(self, runs: Iterable[Run]) -> None:
        write_atomically(self._folder / RUNS, sealed({RUNS: [asdict(one) for one in runs]}))

    def _rows(self, result: EpisodeResult) -> tuple[Sequence[Any], Sequence[Any]]:
        """An episode's rows in both tables."""
        row, times = list(result.row().values()), " ".join(map(str, result.decision_ms.tolist()))
        return (result.policy, result.episode, _checksum(self._own, row, times), times), row

    def _read(self, comparison: Mapping[str, Any], episodes: int) -> EpisodeTable:
        self._check_same(comparison)
        kept = read_episodes(self._folder, comparison)
        if (last := kept.column("episode").max(initial=0)) >= episodes:
            raise ResultsError(
                f"{self._folder} already holds episode {last}, beyond the {episodes} asked for: ask for more, choose "
                "another folder, or overwrite them (--overwrite)"
            )
        return kept

    def _check_same(self, comparison: Mapping[str, Any]) -> None:
        otherwise = "choose another folder, or overwrite them (--overwrite)"
        try:
            stored = unsealed(bounded_text(self._folder / COMPARISON))
        except (OSError, ValueError, RecursionError) as error:
            raise ResultsError(
                f"{self._folder} holds results without a readable {COMPARISON} that identifies them ({error}): "
                f"{otherwise}"
            ) from error
        if what := "; ".join(differences(stored, comparison)):
            raise ResultsError(f"{self._folder} holds results of another comparison ({what}): {otherwise}")


def read_runs(folder: Path) -> list[Run]:
    """The runs in a comparison's folder; none in one of an older version. Raises `ResultsError` for a damaged file."""
    path = folder / RUNS
    if not path.exists():
        return []
    try:
        return _RUNS.validate_python(unsealed(bounded_text(path)).get(RUNS))
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} cannot be read ({error}): remove it, or overwrite all (--overwrite)") from error


def _of(results: Iterable[EpisodeResult], runs: Iterable[Run]) -> list[Run]:
    """The runs that have played any of the results, or told a verdict by other arguments than all before."""
    played = set(table_of(results).column("run").tolist())
    kept: list[Run] = []
    for one in runs:
        told = {(other.baseline, other.margin) for other in kept if other.judged}
        if one.id in played or (one.judged and (one.baseline, one.margin) not in told):
            kept.append(one)
    return kept


def read_episodes(folder: Path, comparison: Mapping[str, Any]) -> EpisodeTable:
    """The finished episodes in a comparison's folder, in file order. Raises `ResultsError` for damaged files."""
    own = digest(comparison)
    unknown = {"run": ""}  # of episodes of an older version
    times = _DecisionRows(folder / DECISIONS)
    path, kept = folder / EPISODES, EpisodeTable()
    known: dict[str, set[str]] = defaultdict(set)
    for line, row in _rows(path, COLUMNS, COLUMNS[:-1]):
        with _damage(path, line):
            if row["episode"] in known[row["policy"]]:
                raise ValueError(f"episode {row['episode']} of {row['policy']} for the second time")
            if (timed := times.of(row["policy"], row["episode"])) is None:
                continue
            spent = timed["decision_ms"]
            if timed["checksum"] != _checksum(own, row.values(), spent):
                raise ValueError("it, or its line in decisions.csv, was changed, or belongs to another comparison")
            result = EpisodeResult.from_row(unknown | row, np.array(spent.split(), dtype=float))
            expected = bare_id(comparison["env"]), comparison["seed"], len(result.decision_ms)
            if (result.env, result.seed, result.length) != expected or result.policy not in comparison["policies"]:
                raise ValueError("not an episode of this comparison")
            if result.episode < 0:
                raise ValueError(f"{result.episode} is not the number of an episode")
            kept.append(result)
        known[row["policy"]].add(row["episode"])
    times.finish()
    return kept


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


def _rows(path: Path, columns: tuple[str, ...], older: tuple[str, ...] = ()) -> Iterator[tuple[int, dict[str, str]]]:
    """The lines of a table, by number, without an incomplete last one."""
    csv.field_size_limit(LARGEST_FIELD)
    try:
        with opened_regular(path, LARGEST_TABLE) as file:
            lines = csv.reader(line.decode() for line in file if line.endswith(b"\n"))
            for line, values in enumerate(lines, start=1):
                if line == 1 and tuple(values) == older:
                    columns = older
                if len(values) != len(columns) or (line == 1 and tuple(values) != columns):
                    raise csv.Error(f"it does not have the columns {', '.join(columns)}")
                if line > 1:
                    yield line, dict(zip(columns, values, strict=True))
    except csv.Error as error:
        raise ResultsError(f"{path} is damaged in line {lines.line_num}: {error}") from error
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} cannot be read: {error}; overwrite all (--overwrite)") from error


def _checksum(own: str, row: Iterable[Any], times: str) -> str:
    return f"{zlib.crc32((own + _lines([row]) + times).encode()):08x}"


def _written(path: Path) -> IO[str]:
    return path.open("w", newline="", encoding="utf-8")


@contextlib.contextmanager
def _appended(path: Path) -> Iterator[IO[str]]:
    file = open(path, "a", newline="", encoding="utf-8", opener=open_without_links)  # noqa: SIM115
    try:
        yield file
    finally:
        with contextlib.suppress(OSError):  # `finish` tells of a full disk
            file.close()


def _lines(rows: Iterable[Iterable[Any]]) -> str:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
