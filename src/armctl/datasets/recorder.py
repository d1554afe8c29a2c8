"""Keeps the observations of a collection, and assembles the dataset of them.

Minari rewrites a dataset's files in place, so that a killed process can leave none that is readable. So the
observations of each finished episode are a file of their own, until the dataset is assembled of them.
"""

import json
import re
import shutil
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ResultsError
from armctl.core.files import CHECKSUM, FORMAT, bounded_text, write_atomically
from armctl.datasets.demonstrations import OBSERVATIONS, Demonstration, RecordingWorlds, observations_of, parts_of
from armctl.datasets.formats import Format, load_formats
from armctl.datasets.minari import UNFINISHED, check_recordable
from armctl.envs import EpisodeVectorEnv
from armctl.episodes.failures import PolicyFailed, failure_of
from armctl.episodes.record import EpisodeResult, FailedEpisode
from armctl.episodes.table import EpisodeTable
from armctl.policies import WorldsByInterface
from armctl.runtime.folder import OTHERWISE, read_sealed
from armctl.study.cell import Recorder
from armctl.study.comparison import Comparison
from armctl.study.plan import Cell

_EPISODE = re.compile(r"episode_\d+\.npz|\.armctl-")
FORMAT_NUMBER = 1
"""Format of armctl's own part of a dataset's metadata."""


class WorldsAsAsked(WorldsByInterface):
    """Worlds with the interface that was asked for, whoever plays in them: it is what is recorded."""

    left_out = frozenset()

    def of(self, policy: Any) -> EpisodeVectorEnv:
        """Return these worlds, whatever the policy."""
        return self.requested


@dataclass
class DatasetRecorder(Recorder):
    """Records a dataset of a `format` in a folder."""

    interfaces = WorldsAsAsked
    recording = RecordingWorlds

    folder: Path
    format: str
    kind: Format
    metadata: dict[str, Any]
    """Metadata of the dataset that do not follow from its worlds and its episodes."""
    planned: int
    overwrite: bool
    failure: PolicyFailed | None = None
    """The first failure in an episode, which is no demonstration then."""
    _is_complete: bool = field(default=False, init=False)
    _num_kept: int = field(default=0, init=False)

    def check(self, env: EpisodeVectorEnv, cell: Cell) -> None:
        """Describe the dataset. Raise `ConfigurationError` or `ResultsError` if it cannot be recorded here."""
        check_recordable(env)
        self.metadata |= self.kind.describe(self.folder, cell.env, cell.env_options, env)
        if link := next((part for part in self._parts() if part.is_symlink()), None):
            raise ResultsError(f"{link} is a symbolic link, through which armctl does not write: choose another folder")
        if foreign := next((part for part in self._parts() if part.exists() and not self._is_own(part)), None):
            raise ResultsError(f"{foreign} would be replaced, and armctl did not write it: choose another folder")
        if self.overwrite:
            return
        for name, other in load_formats().items():
            if name != self.format and (self.folder / other.MANIFEST).exists():
                raise ResultsError(f"{self.folder} already holds a dataset in the format {name}: {OTHERWISE}")
        if self._has_dataset():
            stored = read_sealed(self.folder / self.kind.MANIFEST, format_number=FORMAT_NUMBER)
            if (count := stored.get("total_episodes")) != self.planned:
                raise ResultsError(
                    f"{self.folder} already holds a dataset, of {count} episodes, not {self.planned}: {OTHERWISE}"
                )

    def open(self) -> None:
        """Delete the folder's dataset, of whatever format, if it is to be overwritten."""
        for part in self._parts() if self.overwrite else ():
            if part.exists():
                shutil.rmtree(part)
        self._is_complete = self._has_dataset()

    def lost(self, kept: EpisodeTable) -> NDArray[np.int64]:
        """Return the numbers of the `kept` episodes whose observations are lost. Raises `ResultsError`."""
        numbers: NDArray[np.int64] = kept.column("episode")
        if self._is_complete:
            if len(kept) < self.planned:
                raise ResultsError(f"{self.folder} already holds a dataset, and not all results of it: {OTHERWISE}")
            return numbers[:0]
        lost = numbers[[not self._is_readable(number) for number in numbers]]
        self._num_kept = len(kept) - len(lost)
        return lost

    def keep(self, result: EpisodeResult) -> bool:
        """Keep the observations of an episode; return False if the policy failed in it. Raises `ResultsError`."""
        if isinstance(result, FailedEpisode):
            self.failure = self.failure or failure_of(result)
            return False
        for name, values in parts_of(result.recording.observations).items():
            if values.dtype.kind == "f" and not np.isfinite(values).all():
                raise ResultsError(
                    f"{name} of episode {result.episode} has numbers that are not finite, which no dataset holds: "
                    "replace them by a wrapper of the environment (gymnasium.ObservationWrapper)"
                )
        try:
            self._path(result.episode).parent.mkdir(exist_ok=True)
            _write(self._path(result.episode), result.recording)
        except OSError as error:
            raise self._not_written(error) from error
        self._num_kept += 1
        return True

    def finish(self, comparison: Comparison) -> None:
        """Make the dataset of the finished episodes. Raises `ResultsError`, and then keeps the episodes."""
        unfinished = self.folder / UNFINISHED
        if comparison.facts.disqualified:
            shutil.rmtree(unfinished, ignore_errors=True)
        if self._is_complete or "results" in comparison.failures or not len(comparison.results):
            return
        results = comparison.results
        outcomes = dict(zip(results.column("episode").tolist(), results.column("outcome").tolist(), strict=True))
        num_episodes, num_steps, num_successes = totals(results)
        metadata = {
            **self.metadata,
            FORMAT: FORMAT_NUMBER,
            "sees": comparison.facts.policies[self.metadata["algorithm_name"]].sees,
            "identity": {**comparison.identity, "format": self.format},
            "total_episodes": num_episodes,
            "total_steps": num_steps,
            "outcomes": dict(sorted(Counter(outcomes.values()).items())),
            "successes": num_successes,
        }
        built_parts = [unfinished / part for part in self.kind.PARTS]
        try:
            for old in (*built_parts, *(self.folder / part for part in self.kind.PARTS)):
                if old.exists():
                    shutil.rmtree(old)
            episodes = self._episodes(outcomes, comparison.seed)
            self.kind.write_dataset(unfinished, episodes, json.loads(json.dumps(metadata)))
            for part in built_parts:
                if part.exists():
                    part.rename(self.folder / part.name)
        except OSError as error:
            for part in built_parts:
                shutil.rmtree(part, ignore_errors=True)
            raise self._not_written(error) from error
        if num_episodes == self.planned:
            shutil.rmtree(unfinished)

    def _episodes(self, outcomes: Mapping[int, str], seed: int) -> Iterator[tuple[Demonstration, dict[str, Any]]]:
        for number in sorted(outcomes):
            episode = _read(self._path(number))
            about = {"seed": seed, "options/episode": number, "outcome": outcomes[number], "success": episode.success}
            yield episode, about

    def _parts(self) -> list[Path]:
        """Return the folders of datasets, finished or not."""
        formats = [other for other in load_formats().values() if (self.folder / other.MANIFEST).exists()]
        names = dict.fromkeys(name for kind in (self.kind, *formats) for name in (*kind.PARTS, UNFINISHED))
        return [self.folder / name for name in names]

    def _is_own(self, part: Path) -> bool:
        """Return whether armctl has written a part of a dataset: it has a manifest, or its collection is unfinished."""
        unfinished, formats = self.folder / UNFINISHED, load_formats().values()
        names = {name for kind in formats for name in kind.PARTS}
        if unfinished.exists() and all(
            path.name in names or _EPISODE.match(path.name) for path in unfinished.iterdir()
        ):
            return True
        return any(part.name in kind.PARTS and CHECKSUM in _text(self.folder / kind.MANIFEST) for kind in formats)

    def _has_dataset(self) -> bool:
        """Return whether a finished dataset, or something in its place, is in the folder."""
        return not (self.folder / UNFINISHED).exists() and any(part.exists() for part in self._parts())

    def _is_readable(self, number: int) -> bool:
        try:
            _read(self._path(number))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return False
        return True

    def _path(self, number: int) -> Path:
        return self.folder / UNFINISHED / f"episode_{number}.npz"

    def _not_written(self, error: OSError) -> ResultsError:
        """Return the error for a disk that is full, or the like: it says what is kept."""
        kept = f". Its {self._num_kept} finished episodes are kept: the same command resumes" if self._num_kept else ""
        return ResultsError(f"the dataset could not be written to {self.folder}: {error.strerror or error}{kept}")


def totals(results: EpisodeTable) -> tuple[int, int, int]:
    """Return the numbers of episodes, of control steps and of successes."""
    return len(results), int(results.column("length").sum()), sum(map(bool, results.column("success")))


def _text(file: Path) -> str:
    """Return the text of a file; nothing for one that cannot be read."""
    try:
        return bounded_text(file)
    except (OSError, ValueError):
        return ""


def _write(path: Path, episode: Demonstration) -> None:
    arrays: dict[str, Any] = {"actions": episode.actions, "rewards": episode.rewards}
    arrays |= {"terminated": episode.terminated, "success": episode.success, **parts_of(episode.observations)}
    write_atomically(path, lambda unfinished: np.savez(unfinished, allow_pickle=False, **arrays))


def _read(path: Path) -> Demonstration:
    with np.load(path, allow_pickle=False) as arrays:
        parts = {name: arrays[name] for name in arrays.files if name.startswith(OBSERVATIONS)}
        return Demonstration(
            observations_of(parts), arrays["actions"], arrays["rewards"], bool(arrays["terminated"]),
            bool(arrays["success"]),
        )  # fmt: skip
