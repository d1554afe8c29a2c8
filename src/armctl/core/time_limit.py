"""Limit of the time that a call of other people's code may take in this process.

The main thread is interrupted by a signal, as soon as Python runs there again. Compiled code that does not come back
cannot be interrupted within its process; neither can another thread.
"""

import contextlib
import signal
import threading
from collections.abc import Iterator
from time import perf_counter
from types import FrameType

from armctl.core.errors import TookTooLong


class _Overdue(BaseException):
    """The limit has passed. It is no `Exception`, which the interrupted code might handle."""


@contextlib.contextmanager
def time_limit(seconds: float | None, doing: str) -> Iterator[None]:
    """Interrupt the code inside after some seconds; None: never.

    Raises `TookTooLong`: when the code is interrupted, or when it comes back later than that.
    """
    if seconds is None:
        yield
        return
    start = perf_counter()
    try:
        with _alarm(seconds) if threading.current_thread() is threading.main_thread() else contextlib.nullcontext():
            yield
    except _Overdue:
        pass
    if perf_counter() - start > seconds:
        raise TookTooLong(f"{doing} took more than {seconds:g} s (--timeout)")


@contextlib.contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    def interrupt(number: int, frame: FrameType | None) -> None:
        raise _Overdue

    previous = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, previous)
