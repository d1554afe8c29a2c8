"""Full disks: a training raises one clear error, and leaves no half file under a name that counts."""

import errno
import io
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from armctl.core.errors import ResultsError

DISK_FULL_ERRNOS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS}
"""Error numbers of a disk that is full, or fails."""


@contextmanager
def raise_on_full_disk(out: Path) -> Iterator[None]:
    """Raise `ResultsError` about the folder of a training instead of the `OSError` of a full disk."""
    with _silence_writer_threads():
        try:
            yield
        except OSError as error:
            if error.errno not in DISK_FULL_ERRNOS:
                raise
            raise ResultsError(
                f"the training cannot be written to {out}: {error.strerror}. What was finished is kept: with room on "
                "the disk, the same command with --resume resumes from the newest checkpoint"
            ) from error


def torch_bytes(value: Any) -> bytes:
    """Return what `torch.save` writes, which turns a full disk into a `RuntimeError` if it is given a path."""
    buffer = io.BytesIO()
    torch.save(value, buffer)
    return buffer.getvalue()


@contextmanager
def _silence_writer_threads() -> Iterator[None]:
    """Let TensorBoard's thread hand its error over to ours, as it does, without printing it too."""
    previous_hook = threading.excepthook

    def hook(failed: threading.ExceptHookArgs) -> None:
        if not _hands_over(failed.thread):
            previous_hook(failed)

    threading.excepthook = hook
    try:
        yield
    finally:
        for thread in filter(_hands_over, threading.enumerate()):
            thread.join()
        threading.excepthook = previous_hook


def _hands_over(thread: threading.Thread | None) -> bool:
    return isinstance(getattr(thread, "exception", None), OSError)
