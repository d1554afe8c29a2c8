"""What a training does when the disk is full: one clear error, and no half file under a name that counts."""

import errno
import io
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from armctl.core.errors import ResultsError

FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}
"""Errors of a disk that is full, or fails."""


@contextmanager
def full_disk_told(out: Path) -> Iterator[None]:
    """Raise `ResultsError` about the folder of a training instead of the `OSError` of a full disk."""
    with _no_word_of_threads():
        try:
            yield
        except OSError as error:
            if error.errno not in FULL:
                raise
            raise ResultsError(
                f"the training cannot be written to {out}: {error.strerror}. What was finished is kept: with room on "
                "the disk, the same command with --resume resumes from the newest checkpoint"
            ) from error


def save_torch(value: Any, path: Path) -> None:
    """What `torch.save` does; to a path, that would turn a full disk into a `RuntimeError`."""
    buffer = io.BytesIO()
    torch.save(value, buffer)
    path.write_bytes(buffer.getbuffer())


@contextmanager
def _no_word_of_threads() -> Iterator[None]:
    """Let TensorBoard's thread hand its error over to ours, as it does, without printing it too."""
    theirs = threading.excepthook

    def told(failed: threading.ExceptHookArgs) -> None:
        if not _hands_over(failed.thread):
            theirs(failed)

    threading.excepthook = told
    try:
        yield
    finally:
        for thread in filter(_hands_over, threading.enumerate()):
            thread.join()
        threading.excepthook = theirs


def _hands_over(thread: threading.Thread | None) -> bool:
    return isinstance(getattr(thread, "exception", None), OSError)
