"""Interrupts (Ctrl-C) that compiled code would swallow."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType


@contextlib.contextmanager
def interrupts_raised() -> Iterator[None]:
    """Raise what an interrupt has raised within the block, also if it does not leave the compiled code there.

    An interrupt is raised where Python runs next. If that is a function that compiled code calls back, ctypes writes
    the exception to stderr, and CasADi takes it for a failure of its search: both go on.
    """
    handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(handler):
        yield
        return
    errors: list[BaseException] = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        try:
            handler(number, frame)
        except BaseException as error:
            errors.append(error)
            raise

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    except Exception:
        if not errors:
            raise
    finally:
        signal.signal(signal.SIGINT, handler)
    if errors:
        raise errors[0]
