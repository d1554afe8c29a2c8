"""The interface of experiment trackers, and how one is found by its name."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from armctl.core.registration import installed, load_installed

TRACKERS = "armctl.trackers"
PROJECT = "armctl"
"""The project or experiment that runs go to, unless the user's settings of the tracker name another."""

Ending = Literal["finished", "interrupted", "failed"]


class Tracker(ABC):
    """One training's run in an experiment tracker.

    All calls come from one thread, beside the training's. What any of them raises ends the tracking alone.
    """

    run: str
    """The tracker's id of the run. It is kept in the training's folder, and given when the training is resumed."""
    where: str
    """Address of the run, or the command that shows or uploads it."""

    @abstractmethod
    def __init__(self, name: str, folder: Path, config: Mapping[str, Any], run: str | None) -> None:
        """Begin a run, or continue the one with the id `run`.

        `folder` is for the tracker's own files, if it keeps any; `config` has JSON values, nested ones too.
        """

    @abstractmethod
    def log(self, steps: int, values: Mapping[str, float]) -> None:
        """Record values after so many environment steps of the training."""

    @abstractmethod
    def agent(self, files: Sequence[Path]) -> None:
        """Record the finished agent: its graph, its card, and its learning curve."""

    @abstractmethod
    def video(self, file: Path, steps: int) -> None:
        """Record a video (`.mp4`) of the agent, which was trained for so many steps."""

    @abstractmethod
    def finish(self, ending: Ending) -> None:
        """End the run, or this part of it, and write or upload whatever has not been."""


def tracker_names() -> list[str]:
    """Names of all installed trackers."""
    return sorted(installed(TRACKERS).names)


def load_tracker(name: str) -> type[Tracker]:
    """Return the installed tracker of that name. Raises `ConfigurationError`, also if its extra is not installed."""
    return load_installed(TRACKERS, name, "tracker")  # type: ignore[no-any-return]
