"""A comparison's folder. Every episode is written as it ends, so that an interrupted comparison can be resumed."""

import contextlib
import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from armctl.errors import ResultsError
from armctl.evaluation.record import COLUMNS, EpisodeResult
from armctl.files import write_atomically
from armctl.registration import bare_id

COMPARISON, EPISODES, DECISIONS, SUMMARY = "comparison.json", "episodes.csv", "decisions.csv", "summary.json"
DECISION_COLUMNS = ("policy", "episode", "decision_ms")
"""The last column holds the episode's decision times, ms, separated by spaces."""


class EpisodeLog:
    """Writes `comparison.json`, which identifies the comparison, and episodes to `decisions.csv` and `episodes.csv`.

    `kept` are the episodes that an earlier run of the same comparison has finished, except for an incomplete last line
    and for episodes without decision times.

    Raises `ResultsError` if the folder cannot be written, is damaged, or holds another comparison's results (unless
    `overwrite`).
    """

    def __init__(self, folder: Path, comparison: Mapping[str, Any], episodes: int, overwrite: bool = False) -> None:
        self._folder = folder
        resuming = (folder / EPISODES).exists() and not overwrite
        self.kept = self._read(comparison, episodes) if resuming else []
        self._files: list[IO[str]] = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / SUMMARY).unlink(missing_ok=True)
            if resuming:
                self.rewrite(self.kept)
            else:
                write_atomically(folder / COMPARISON, json.dumps(comparison, indent=2) + "\n")
            for name, columns in ((DECISIONS, DECISION_COLUMNS), (EPISODES, COLUMNS)):
                self._files.append((folder / name).open("a" if resuming else "w", newline=""))
                if not resuming:
                    self._files[-1].write(_lines([columns]))
        except OSError as error:
            self._close()
            raise ResultsError(f"results cannot be written to {folder}: {error.strerror}") from error

    def __enter__(self) -> "EpisodeLog":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def write(self, result: EpisodeResult) -> None:
        """Append an episode, and flush it to the operating system."""
        try:
            for file, row in zip(self._files, (_decisions(result), result.row().values()), strict=True):
                file.write(_lines([row]))
                file.flush()
        except OSError as error:
            raise ResultsError(
                f"{self._folder / EPISODES} could not be written any further ({error.strerror}); it holds the episodes "
                "before"
            ) from error

    def rewrite(self, results: Iterable[EpisodeResult]) -> None:
        """Replace all rows by these, in this order. Raises `ResultsError`, and then leaves the old rows."""
        results = list(results)
        try:
            write_atomically(self._folder / DECISIONS, _lines([DECISION_COLUMNS, *map(_decisions, results)]))
            write_atomically(self._folder / EPISODES, _lines([COLUMNS, *(result.row().values() for result in results)]))
        except OSError as error:
            raise ResultsError(f"results cannot be written to {self._folder}: {error.strerror}") from error

    def _close(self) -> None:
        for file in self._files:
            with contextlib.suppress(OSError):  # a full disk was reported by `write`
                file.close()

    def _read(self, comparison: Mapping[str, Any], episodes: int) -> list[EpisodeResult]:
        self._check_same(comparison)
        kept = read_episodes(self._folder, comparison)
        if (last := max((result.episode for result in kept), default=0)) >= episodes:
            raise ResultsError(
                f"{self._folder} already holds episode {last}, beyond the {episodes} asked for: ask for more, choose "
                "another folder, or overwrite them (--overwrite)"
            )
        return kept

    def _check_same(self, comparison: Mapping[str, Any]) -> None:
        otherwise = "choose another folder, or overwrite them (--overwrite)"
        try:
            stored = json.loads((self._folder / COMPARISON).read_text())
            differing = [name for name in comparison if stored[name] != comparison[name]]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ResultsError(
                f"{self._folder} holds results without a readable {COMPARISON} that identifies them: {otherwise}"
            ) from error
        if differing:
            what = "; ".join(f"{name}: {stored[name]} there, {comparison[name]} here" for name in differing)
            raise ResultsError(f"{self._folder} holds results of another comparison ({what}): {otherwise}")


def read_episodes(folder: Path, comparison: Mapping[str, Any]) -> list[EpisodeResult]:
    """The finished episodes in a comparison's folder, in file order. Raises `ResultsError` for damaged files."""
    path = folder / DECISIONS
    times: dict[tuple[str, str], NDArray[np.float64]] = {}
    for line, row in _rows(path, DECISION_COLUMNS):
        with _damage(path, line):
            times[row["policy"], row["episode"]] = np.array(row["decision_ms"].split(), dtype=float)
    path, kept = folder / EPISODES, {}
    for line, row in _rows(path, COLUMNS):
        with _damage(path, line):
            if (pair := (row["policy"], row["episode"])) not in times:
                continue
            result = EpisodeResult.from_row(row, times[pair])
            expected = bare_id(comparison["env"]), comparison["seed"], len(result.decision_ms)
            if (result.env, result.seed, result.length) != expected or result.policy not in comparison["policies"]:
                raise ValueError("not an episode of this comparison")
            if pair in kept:
                raise ValueError(f"episode {result.episode} of {result.policy} for the second time")
            if result.episode < 0:
                raise ValueError(f"{result.episode} is not the number of an episode")
        kept[pair] = result
    return list(kept.values())


@contextlib.contextmanager
def _damage(path: Path, line: int) -> Iterator[None]:
    try:
        yield
    except (ValueError, KeyError, TypeError) as error:
        raise ResultsError(
            f"{path} is damaged in line {line} ({error}): repair or remove the line, or overwrite all (--overwrite)"
        ) from error


def _rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[int, dict[str, str]]]:
    """The lines of a table, by number, without an incomplete last one."""
    try:
        whole, newline, _ = path.read_text().rpartition("\n")
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} cannot be read: {error}; overwrite all (--overwrite)") from error
    lines = csv.reader(io.StringIO(whole + newline))
    for line, values in enumerate(lines, start=1):
        if len(values) != len(columns) or (line == 1 and tuple(values) != columns):
            raise ResultsError(f"{path} is damaged in line {line}: it does not have the columns {', '.join(columns)}")
        if line > 1:
            yield line, dict(zip(columns, values, strict=True))


def _decisions(result: EpisodeResult) -> tuple[Any, ...]:
    return result.policy, result.episode, " ".join(map(str, result.decision_ms.tolist()))


def _lines(rows: Iterable[Iterable[Any]]) -> str:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
