"""Formats in which `collect` writes datasets: modules, which packages offer in the entry-point group of `FORMATS`."""

import contextlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

from armctl.core.errors import ConfigurationError
from armctl.core.registration import installed, load_installed
from armctl.datasets.demonstrations import Demonstration
from armctl.envs import EpisodeVectorEnv

FORMATS = "armctl.dataset_formats"


class Format(Protocol):
    """Interface of a format's module."""

    PARTS: tuple[str, ...]
    """The folders within the dataset's folder of which it may consist; that of the manifest is the last."""
    MANIFEST: str
    """The file within the dataset's folder that has its identity."""

    def library_versions(self) -> dict[str, str]:
        """Versions of what writes the dataset; raises `ConfigurationError` if it is not installed."""

    def describe(
        self, folder: Path, env: str, env_options: Mapping[str, Any], worlds: EpisodeVectorEnv
    ) -> dict[str, Any]:
        """Return the metadata, as JSON values, of a dataset in this folder."""

    def write_dataset(
        self, folder: Path, episodes: Iterable[tuple[Demonstration, Mapping[str, Any]]], metadata: Mapping[str, Any]
    ) -> None:
        """Write `PARTS` to a folder: episodes with their attributes, and metadata. Raises `OSError`."""


def load_format(name: str) -> Format:
    """Return the installed format of that name. Raises `ConfigurationError`."""
    return load_installed(FORMATS, name, "dataset format")  # type: ignore[no-any-return]


def load_formats() -> dict[str, Format]:
    """Return all installed formats by name; those of a package that is broken are left out."""
    formats = {}
    for name in sorted(installed(FORMATS).names):
        with contextlib.suppress(ConfigurationError):
            formats[name] = load_format(name)
    return formats
