"""Files that are replaced as a whole, so that an interrupt or a full disk leaves no half-written one."""

import contextlib
from collections.abc import Callable
from pathlib import Path


def write_atomically(path: Path, content: str | Callable[[Path], object]) -> None:
    """Write a text, or what a function writes to the path it is given. A reader finds the old file or the new one.

    Raises `OSError`, or what the function raises, and leaves the old file as it was.
    """
    unfinished = path.with_name(f"unfinished-{path.name}")  # the same suffix: some writers add one that is missing
    try:
        if isinstance(content, str):
            unfinished.write_text(content, encoding="utf-8", newline="")
        else:
            content(unfinished)
        unfinished.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            unfinished.unlink()
        raise
