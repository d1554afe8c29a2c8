"""Files that are replaced as a whole, folders with one writer at a time, and names that may become files.

A results folder may come from a stranger: nothing in it is written through a symbolic link.
"""

import contextlib
import errno
import hashlib
import json
import math
import os
import re
import stat
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping
from importlib.resources.abc import Traversable
from io import BufferedReader
from pathlib import Path
from typing import Any

import filelock

from armctl import __version__
from armctl.core.errors import ConfigurationError, ResultsError

LOCK = ".lock"
UNFINISHED = ".armctl-unfinished-"
"""Beginning of a file's name until the file is whole."""
LARGEST_TEXT = 64 * 2**20
"""Bytes of a JSON or TOML file that armctl reads."""
LONGEST_NAME = 100
"""Characters of a name that may become a file's or a folder's."""
Content = str | bytes | Callable[[Path], object]
"""Content of a file: a text, bytes, or a function that writes it to the path it is given."""
CHECKSUM = "checksum"
"""The key of a JSON file's checksum of its other entries."""
FORMAT = "format"
"""The key of a JSON file's format number."""
_NAME = re.compile(r"\w[\w. +=-]*")


def write_atomically(path: Path, content: Content) -> None:
    """Write a file as a whole: a reader finds the old one or the new one.

    Raises `OSError`, or what the function raises, and leaves the old file as it was. A device, pipe or folder of that
    name is not replaced.
    """
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        mode = os.lstat(path).st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode)):
            raise FileExistsError(errno.EEXIST, "it is not a regular file", str(path))
    with tempfile.NamedTemporaryFile(prefix=UNFINISHED, suffix=path.suffix, dir=path.parent, delete=False) as temporary:
        unfinished = Path(temporary.name)
    try:
        if isinstance(content, str):
            unfinished.write_text(content, encoding="utf-8", newline="")
        elif isinstance(content, bytes):
            unfinished.write_bytes(content)
        else:
            content(unfinished)
        with unfinished.open("rb") as file:
            os.fsync(file.fileno())
        unfinished.chmod(0o666 & ~_umask())
        unfinished.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def bounded_text(path: Path, largest: int = LARGEST_TEXT) -> str:
    """Return the text of a regular file of at most `largest` bytes. Raises `OSError` or `ValueError`."""
    return bounded_bytes(path, largest).decode("utf-8")


def bounded_bytes(path: Path, largest: int) -> bytes:
    """Return the content of a regular file of at most `largest` bytes. Raises `OSError` or `ValueError`."""
    with opened_regular(path, largest) as file:
        return file.read(largest)


def read_toml(file: Traversable, description: str) -> dict[str, Any]:
    """Return the values of a TOML file, which messages call `description`. Raises `ConfigurationError`."""
    try:
        return tomllib.loads(bounded_text(file) if isinstance(file, Path) else file.read_text("utf-8"))
    except OSError as error:
        raise ConfigurationError(f"the {description} {file} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ConfigurationError(f"{file} is not TOML: {error}") from error
    except RecursionError:
        raise ConfigurationError(f"{file} is nested too deeply for a {description}") from None


def file_checksum(path: Path, largest: float = math.inf) -> str:
    """Return the SHA-256 checksum of a regular file of at most `largest` bytes. Raises `OSError` or `ValueError`."""
    with opened_regular(path, largest) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def opened_regular(path: Path, largest: float = math.inf) -> Iterator[BufferedReader]:
    """Open a regular file of at most `largest` bytes to read. Raises `OSError` or `ValueError`."""
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise ValueError(f"{path} is not a regular file")
        if about.st_size > largest:
            raise ValueError(f"{path} has {about.st_size:,} bytes, more than the {largest:,} that armctl reads")
        yield file


def open_without_links(path: str, flags: int) -> int:
    """Open a file, but refuse symbolic links with `OSError`: an opener for `open`."""
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def inside(folder: Path, name: str) -> Path:
    """Return a folder in another one. Raises `ResultsError` if it is a symbolic link, which may lead elsewhere."""
    if (folder / name).is_symlink():
        raise ResultsError(f"{folder / name} is a symbolic link, through which nothing is written")
    return folder / name


@contextlib.contextmanager
def one_writer(folder: Path) -> Iterator[None]:
    """Make a folder, and keep other processes from writing to it. A process that dies releases it.

    Unfinished files of a killed process are removed.

    Raises `ResultsError` if another process writes there, or if the folder cannot be made or written to.
    """
    lock = filelock.FileLock(folder / LOCK)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except filelock.Timeout:
        raise ResultsError(
            f"another process writes to {folder}: wait until it has finished, or choose another folder"
        ) from None
    except OSError as error:
        raise ResultsError(f"{folder} cannot be written to: {error.strerror}") from error
    with lock:
        for unfinished in folder.glob(f"{UNFINISHED}*"):
            with contextlib.suppress(OSError):
                unfinished.unlink()
        yield


def sealed(values: Mapping[str, Any]) -> str:
    """Return a JSON text with a checksum of its values, which `unsealed` checks: a changed digit is noticed."""
    return json.dumps({**values, CHECKSUM: digest(values)}, indent=2) + "\n"


def unsealed(text: str | bytes, format_number: int | str | None = None) -> dict[str, Any]:
    """Return the values of a text that `sealed` made, and check the format number, if there should be one.

    Raises `ValueError` if the text was changed, has another format, or is something else.
    """
    try:
        values = json.loads(text)
        json.dumps(values, ensure_ascii=False).encode()  # halves of characters can be written nowhere
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if not isinstance(values, dict) or CHECKSUM not in values:
        raise ValueError(f"it has no {CHECKSUM}")
    if format_number is not None:
        check_format(values, format_number)
    claimed = values.pop(CHECKSUM)
    if claimed != digest(values):
        raise ValueError(f"its values do not have the {CHECKSUM} {claimed}: it was changed, or damaged")
    return values


def check_format(values: Mapping[str, Any], expected: int | str) -> None:
    """Raise `ValueError` unless the values of a file have the format that this version of armctl reads and writes."""
    number = values.get(FORMAT)
    if number != expected:
        actual = "no format number" if number is None else f"format {str(number)[:LONGEST_NAME]}"
        raise ValueError(
            f"it has {actual}; armctl {__version__} writes and reads format {expected}: use the version that wrote it"
        )


def digest(values: Any) -> str:
    """Return a short checksum of JSON values."""
    return short_checksum(json.dumps(values, sort_keys=True).encode())


def short_checksum(content: bytes) -> str:
    """Return the first 16 digits of the SHA-256 checksum of some bytes."""
    return hashlib.sha256(content).hexdigest()[:16]


def checked_name(kind: str, name: str) -> str:
    """Return a name that can safely become part of a path. Raises `ConfigurationError`."""
    if not _NAME.fullmatch(name) or len(name) > LONGEST_NAME:
        raise ConfigurationError(
            f"{name[:LONGEST_NAME]!r} cannot be the name of a {kind}: names begin with a letter or digit, and have up "
            f"to {LONGEST_NAME} letters, digits, spaces and . _ + = -"
        )
    return name
