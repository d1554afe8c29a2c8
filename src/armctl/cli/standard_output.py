"""Standard output that holds one document, such as JSON, whatever environments and libraries print meanwhile."""

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator
from typing import IO, Any

TABLE = "table"
_streams: list[IO[str]] = []
"""The document's stream, while standard output is kept for it."""


def document_stream() -> IO[str]:
    """Return where to write a document."""
    return _streams[-1] if _streams else sys.stdout


@contextlib.contextmanager
def standard_output(table_format: str) -> Iterator[None]:
    """Keep standard output for a document, unless the format is a table: all else goes to standard error.

    That holds for what libraries write to the file descriptor, too.
    """
    if table_format == TABLE:
        yield
        return
    output = sys.stdout
    output.flush()
    saved = os.dup(1)
    with contextlib.ExitStack() as stack:
        stack.callback(os.close, saved)
        is_the_descriptor = _descriptor(output) == 1
        _streams.append(stack.enter_context(os.fdopen(os.dup(saved), "w")) if is_the_descriptor else output)
        os.dup2(2, 1)
        sys.stdout = sys.stderr
        try:
            yield
        finally:
            sys.stdout = output
            _streams.pop()
            ctypes.CDLL(None).fflush(None)  # what C libraries have not written yet
            os.dup2(saved, 1)


def _descriptor(file: Any) -> int | None:
    try:
        return int(file.fileno())
    except (OSError, AttributeError):
        return None
