"""A dataset in the making: a folder with one file per finished episode, each written whole.

Minari rewrites a dataset's files in place, so that a killed process can leave none that is readable.
"""

import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from armctl.core.errors import ResultsError
from armctl.core.files import sealed, write_atomically
from armctl.datasets.demonstrations import OBSERVATIONS, Demonstration, observations_of, parts_of
from armctl.runtime.folder import claim
from armctl.runtime.identity import reasons_not_to_resume

IDENTITY = "identity.json"
OTHER_DATASET = "a dataset of another kind"


class Unfinished:
    """The finished episodes of a collection, on disk. `outcomes` holds their outcomes, by number.

    Raises `ResultsError` if the folder holds episodes of another collection, or cannot be written.
    """

    def __init__(self, folder: Path, identity: Mapping[str, Any]) -> None:
        self.folder = folder
        self.outcomes: dict[int, str] = {}
        self.steps = self.successes = 0
        if claim(folder / IDENTITY, identity, OTHER_DATASET, reasons=reasons_not_to_resume) is not None:
            self.count_again()
        try:
            folder.mkdir(parents=True, exist_ok=True)
            write_atomically(folder / IDENTITY, sealed(identity))
        except OSError as error:
            raise self.not_written(error) from error

    def add(self, number: int, outcome: str, episode: Demonstration) -> None:
        """Keep an episode. Raises `ResultsError`."""
        arrays: dict[str, Any] = {"actions": episode.actions, "rewards": episode.rewards, "outcome": outcome}
        arrays |= {"terminated": episode.terminated, "success": episode.success}
        arrays |= parts_of(episode.observations)
        try:
            write_atomically(self._path(number), lambda path: np.savez(path, allow_pickle=False, **arrays))
        except OSError as error:
            raise self.not_written(error) from error
        self._count(number, outcome, episode)

    def count_again(self) -> None:
        """Count what is in the folder: an interrupt may have come after an episode was kept, and before it counted."""
        self.outcomes, self.steps, self.successes = {}, 0, 0
        for path in sorted(self.folder.glob("episode_*.npz")):
            self._find(path)

    def read(self, number: int) -> Demonstration:
        """Return a finished episode."""
        return _read(self._path(number))[1]

    def not_written(self, error: OSError) -> ResultsError:
        """Return the error for a disk that is full, or the like: it says what is kept."""
        kept = f". Its {len(self.outcomes)} finished episodes are kept: the same command resumes"
        return ResultsError(
            f"the dataset could not be written to {self.folder.parent}: {error.strerror or error}"
            f"{kept if self.outcomes else ''}"
        )

    def remove(self) -> None:
        """Delete the folder."""
        shutil.rmtree(self.folder)

    def _find(self, path: Path) -> None:
        try:
            number = int(path.stem.removeprefix("episode_"))
            outcome, episode = _read(path)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return  # damaged: it is played again
        self._count(number, outcome, episode)

    def _count(self, number: int, outcome: str, episode: Demonstration) -> None:
        self.outcomes[number] = outcome
        self.steps += len(episode)
        self.successes += episode.success

    def _path(self, number: int) -> Path:
        return self.folder / f"episode_{number}.npz"


def _read(path: Path) -> tuple[str, Demonstration]:
    with np.load(path, allow_pickle=False) as arrays:
        parts = {name: arrays[name] for name in arrays.files if name.startswith(OBSERVATIONS)}
        return str(arrays["outcome"]), Demonstration(
            observations_of(parts), arrays["actions"], arrays["rewards"], bool(arrays["terminated"]),
            bool(arrays["success"]),
        )  # fmt: skip
