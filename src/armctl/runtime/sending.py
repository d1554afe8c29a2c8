"""Bundles of work for another machine: objects, the files that they name, and modules of the user's own.

There, files lie in a temporary folder as they lie here in the root folder. So relative paths name the same files, and
own modules are imported from where they were.
"""

import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle

from armctl.core.errors import ConfigurationError
from armctl.runtime.identity import own_modules
from armctl.runtime.own_code import is_library

FORMAT_NUMBER = 1
"""Format of bundles: workers with another one are refused."""
LARGEST = 256 * 2**20
"""Bytes of files that are sent: agents and modules are far smaller, so more of them is a mistake."""


@dataclass(frozen=True)
class JobBundle:
    """Objects, and files by their paths here, relative to the root folder."""

    objects: bytes
    files: Mapping[str, bytes]
    folders: tuple[str, ...]
    """Folders from which modules are imported, relative to the root folder; the first is the working directory."""

    @classmethod
    def of(cls, objects: Any, files: Iterable[Path]) -> "JobBundle":
        """Pack objects with these files and all own modules.

        Raises `ConfigurationError` if something cannot be sent, or a module's file has changed since it was imported.
        """
        modules = own_modules()
        to_send = dict.fromkeys([*map(Path.absolute, files), *modules.values()])
        if (size := sum(file.stat().st_size for file in to_send)) > LARGEST:
            raise ConfigurationError(f"{len(to_send)} files with {size:,} bytes are too large to be sent to workers")
        homes = dict.fromkeys([Path.cwd(), *(_home(name, file) for name, file in modules.items())])
        try:
            packed = cloudpickle.dumps(objects)
        except Exception as error:  # pickling an object may raise anything
            raise ConfigurationError(f"this cannot be sent to worker processes: {error}") from error
        return cls(packed, {_below_root(file): file.read_bytes() for file in to_send}, tuple(map(_below_root, homes)))

    def write(self, root: Path) -> None:
        """Write all files below a folder."""
        for name, content in self.files.items():
            file = root / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        for folder in self.folders:
            (root / folder).mkdir(parents=True, exist_ok=True)

    def open_in(self, root: Path) -> Any:
        """Return the objects in a new process, which works below the folder and imports own modules from there only.

        Raises whatever own modules raise.
        """
        os.chdir(root / self.folders[0])
        sys.path[:] = [place for place in sys.path if place and is_library(Path(place))]
        sys.path += [str(root / folder) for folder in self.folders]
        return cloudpickle.loads(self.objects)


def relative(name: str) -> str:
    """Return a path, or `path.py:NAME`, as it is called from the working directory; any other name as it is."""
    return os.path.relpath(name) if Path(name).is_absolute() else name


def _home(module: str, file: Path) -> Path:
    """Return the folder from which a module is imported; that of its file, if its name is an alias."""
    levels = module.count(".") + (file.name == "__init__.py")
    return file.parents[levels] if levels < len(file.parents) else file.parent


def _below_root(path: Path) -> str:
    return path.relative_to(path.anchor).as_posix()
