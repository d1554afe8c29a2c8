"""Tells code of one's own from that of Python, of installed packages and of armctl's core, whose versions count."""

import functools
import os
import site
import sys
import sysconfig
from pathlib import Path, PurePath
from types import ModuleType

from armctl.core.registration import installed
from armctl.policies.names import GROUP

_PACKAGES = {"site-packages", "dist-packages"}
"""Folders of installed packages, also of another environment that Python's path leads to."""


def is_core(module: ModuleType) -> bool:
    """Return True if a module is armctl's, and not one of the plug-ins that come with it."""
    return f"{module.__name__}.".startswith("armctl.") and not is_plugin(module)


def is_plugin(module: ModuleType) -> bool:
    """Return True if a module belongs to a package that offers policies."""
    return module.__name__.startswith(_plugins())


@functools.cache
def _plugins() -> tuple[str, ...]:
    return tuple({f"{entry.value.partition(':')[0].rpartition('.')[0]}." for entry in installed(GROUP)})


def in_plugin(path: PurePath) -> PurePath:
    """Return a path in a plug-in relative to its folder, which is another on each machine; any other path as it is."""
    folders = (
        Path(file).parent for name in _plugins() if (file := getattr(sys.modules.get(name[:-1]), "__file__", ""))
    )
    return next((path.relative_to(folder) for folder in folders if path.is_relative_to(folder)), path)


def is_own(module: ModuleType) -> bool:
    """Return True if a module is the user's or a plug-in's: neither of another installed package, nor Python's."""
    file = file_of(module)
    if file is None or is_core(module):
        return False
    return is_plugin(module) or not is_library(file)


@functools.cache
def is_library(file: Path) -> bool:
    """Return True if a file or folder belongs to Python or to an installed package."""
    return not _PACKAGES.isdisjoint(file.parts) or any(map(file.is_relative_to, _libraries()))


@functools.cache
def is_library_file(file: str) -> bool:
    """Return True if an absolute path leads to a file of Python or of an installed package."""
    if not os.path.isabs(file):
        return False
    return is_library(Path(file).resolve()) if os.path.islink(file) else _is_library_folder(os.path.dirname(file))


@functools.cache
def _is_library_folder(folder: str) -> bool:
    return is_library(Path(folder).resolve())


@functools.cache
def _libraries() -> tuple[Path, ...]:
    places = (*site.getsitepackages(), site.getusersitepackages(), *sysconfig.get_paths().values())
    return tuple(Path(place).resolve() for place in places)


def file_of(module: ModuleType) -> Path | None:
    """Return a module's file; None if it has none that exists."""
    file = getattr(module, "__file__", None)
    return _resolved(os.path.abspath(file)) if file and os.path.isfile(file) else None


@functools.cache
def _resolved(file: str) -> Path:
    return Path(file).resolve()
