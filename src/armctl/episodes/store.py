"""A comparison's folder. Every episode is written as it ends, so that an interrupted comparison can be resumed."""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any

from pydantic import TypeAdapter

from armctl.core.errors import ResultsError, unknown_name
from armctl.core.files import bounded_text, digest, one_writer, sealed, unsealed, write_atomically
from armctl.episodes.csv_files import Journal, read_csv, write_csv
from armctl.episodes.parquet_files import ROWS, check_parquet, read_parquet, write_parquet
from armctl.episodes.record import EpisodeResult
from armctl.episodes.table import EpisodeTable, table_of
from armctl.runtime.identity import reasons_not_to_resume
from armctl.runtime.provenance import Run

COMPARISON, EPISODES, DECISIONS, SUMMARY = "comparison.json", "episodes.csv", "decisions.csv", "summary.json"
EPISODES_PARQUET, PART = "episodes.parquet", "episodes-{}.parquet"
"""Instead of the CSV tables, and the parts of it while the comparison runs."""
RUNS = "runs.json"
"""The runs that have played episodes (see `Run`) or told another verdict, the present one included."""
STORES = CSV, PARQUET = "csv", "parquet"
"""What a folder holds its episodes as, once all are played."""
POLICY_SEED = "policy_seed"
"""In a comparison's identity: the secret of its policies' random numbers, in decimal digits."""
_RUNS = TypeAdapter(list[Run])


class EpisodeLog:
    """Writes `comparison.json`, which identifies the comparison, and episodes to `decisions.csv` and `episodes.csv`.

    With the `store` `parquet`, these are a journal of at most `ROWS` episodes, of which `episodes-1.parquet` and so on
    are made; in the end, all are in `episodes.parquet`, and there are no other tables. Whichever there is is resumed.

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
        store: str = CSV,
    ) -> None:
        self._own, self._store = digest(comparison), store
        self._tables = folder / EPISODES, folder / DECISIONS
        self._parts, self._unparted = 0, EpisodeTable()
        self.runs: list[Run] = []
        """The runs of `kept`, as far as they are known."""
        self._folder = folder
        self._opened = contextlib.ExitStack()
        self._failure: OSError | None = None
        try:
            self._opened.enter_context(one_writer(folder))
            resuming = bool(_parquet_files(folder) or (folder / EPISODES).exists()) and not overwrite
            if resuming:
                comparison = self._same(comparison)
                self._own = digest(comparison)
            self.kept = self._read(comparison, episodes) if resuming else EpisodeTable()
            self.runs = _of(self.kept, read_runs(folder)) if resuming else []
            (folder / SUMMARY).unlink(missing_ok=True)
            if not resuming:
                for path in (*self._tables, *_parquet_files(folder)):  # first: no row is ever beside another identity
                    path.unlink(missing_ok=True)
                write_atomically(folder / COMPARISON, sealed(comparison))
            self._write_runs([*self.runs, *([run] if run else [])])  # first, so that every row's run is known
            self._replace(self.kept)
            self._journal = self._opened.enter_context(contextlib.closing(Journal(*self._tables, self._own)))
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
            self._journal.write(result)
            if self._store == PARQUET:
                self._unparted.append(result)
                if len(self._unparted) == ROWS:
                    self._end_part()
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
            self._replace(table_of(results))
            if self._store == PARQUET:
                for path in self._tables:
                    path.unlink()
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

    def _replace(self, results: EpisodeTable) -> None:
        """Replace all rows by these. What was there goes last: an episode that is in two files counts once."""
        outdated = _parquet_files(self._folder)
        if self._store == PARQUET:
            write_parquet(self._folder / EPISODES_PARQUET, self._own, results)
            outdated = [path for path in outdated if path.name != EPISODES_PARQUET]
        write_csv(*self._tables, self._own, results if self._store == CSV else ())
        for path in outdated:
            path.unlink()

    def _end_part(self) -> None:
        """Make a Parquet file of the episodes in the journal, which begins anew."""
        self._parts += 1
        write_parquet(self._folder / PART.format(self._parts), self._own, self._unparted)
        self._unparted = EpisodeTable()
        self._journal.restart()

    def _write_runs(self, runs: Iterable[Run]) -> None:
        write_atomically(self._folder / RUNS, sealed({RUNS: [asdict(one) for one in runs]}))

    def _read(self, comparison: Mapping[str, Any], episodes: int) -> EpisodeTable:
        kept = read_episodes(self._folder, comparison)
        if (last := kept.column("episode").max(initial=0)) >= episodes:
            raise ResultsError(
                f"{self._folder} already holds episode {last}, beyond the {episodes} asked for: ask for more, choose "
                "another folder, or overwrite them (--overwrite)"
            )
        return kept

    def _same(self, comparison: Mapping[str, Any]) -> dict[str, Any]:
        """The stored identity of this comparison. Raises `ResultsError` if it is another's."""
        otherwise = "choose another folder, or overwrite them (--overwrite)"
        try:
            stored = unsealed(bounded_text(self._folder / COMPARISON))
        except (OSError, ValueError, RecursionError) as error:
            raise ResultsError(
                f"{self._folder} holds results without a readable {COMPARISON} that identifies them ({error}): "
                f"{otherwise}"
            ) from error
        if what := "; ".join(reasons_not_to_resume(stored, comparison)):
            raise ResultsError(f"{self._folder} holds results of another comparison ({what}): {otherwise}")
        return stored


def stored_policy_seed(path: Path) -> int | None:
    """The policy seed of an identity in a file; None if there is none that can be read."""
    try:
        values = unsealed(bounded_text(path))
        return int(values.get("identity", values)[POLICY_SEED])
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None


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
    kept, parquet = EpisodeTable(), _parquet_files(folder)
    for path in parquet:
        known = len(kept)
        read_parquet(path, comparison, kept)
        if kept[known:].repeats.any():
            raise ResultsError(f"{path} has an episode for the second time: overwrite all (--overwrite)")
    if not parquet or (folder / EPISODES).exists():
        read_csv(folder / EPISODES, folder / DECISIONS, comparison, kept)
    repeats = kept.repeats  # of a run that was killed as it replaced one file by another
    return EpisodeTable(kept[~repeats]) if repeats.any() else kept


def check_store(store: str) -> None:
    """Raise `ConfigurationError` for an unknown store, and for one whose packages are not installed."""
    if store not in STORES:
        raise unknown_name("store of episodes", store, STORES)
    if store == PARQUET:
        check_parquet()


def _parquet_files(folder: Path) -> list[Path]:
    return [path for path in (folder / EPISODES_PARQUET, *sorted(folder.glob(PART.format("*")))) if path.exists()]
