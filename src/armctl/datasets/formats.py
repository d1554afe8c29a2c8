"""The formats in which `collect` writes datasets: each is a module."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

from armctl.core.errors import unknown_name
from armctl.datasets import lerobot, minari
from armctl.datasets.demonstrations import Demonstration
from armctl.envs import EpisodeVectorEnv


class Format(Protocol):
    """What a format's module has."""

    PARTS: tuple[str, ...]
    """The folders within the dataset's folder of which it may consist; that of the manifest is the last."""
    MANIFEST: str
    """The file within the dataset's folder that has its identity."""

    def library_versions(self) -> dict[str, str]:
        """Versions of what writes the dataset; raises `ConfigurationError` if it is not installed."""

    def describe(
        self, folder: Path, env: str, env_options: Mapping[str, Any], worlds: EpisodeVectorEnv
    ) -> dict[str, Any]:
        """The metadata, as JSON values, of a dataset in this folder."""

    def write_dataset(
        self, folder: Path, episodes: Iterable[tuple[Demonstration, Mapping[str, Any]]], metadata: Mapping[str, Any]
    ) -> None:
        """Write `PARTS` to a folder: episodes with their attributes, and metadata. Raises `OSError`."""


FORMATS: Mapping[str, Format] = {"minari": minari, "lerobot": lerobot}
"""By the name that the user gives."""


def format_of(name: str) -> Format:
    """The format with a name. Raises `ConfigurationError`."""
    if name not in FORMATS:
        raise unknown_name("dataset format", name, FORMATS)
    return FORMATS[name]
