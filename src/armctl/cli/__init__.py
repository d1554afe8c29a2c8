"""The verbs of the command line. No logic of their own: each calls the library."""

import os
import signal
import sys
import threading
import time
from collections.abc import Sequence, Set
from types import FrameType
from typing import NoReturn

from armctl.cli import catalogue, compare, evaluate, export, judge, learn, new, play, robustness, share, tune
from armctl.cli.app import app, settings
from armctl.core.errors import ArmctlError, format_cause

__all__ = [
    "app",
    "catalogue",
    "compare",
    "evaluate",
    "export",
    "judge",
    "learn",
    "main",
    "new",
    "play",
    "robustness",
    "share",
    "tune",
]

TRACEBACK = "--traceback"
PATIENCE = 2.0
"""s for threads to end with the process before they are named."""
INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it."""


def main() -> NoReturn:
    """Run the command line; armctl's own errors become one line and exit status 2."""
    os.environ["PYTHONSAFEPATH"] = "1"  # worker processes import nothing from the working directory either
    earlier = {*threading.enumerate()}
    words = sys.argv[1:]
    if TRACEBACK in words:  # an option of the application, which Typer knows before the verb only
        words = [TRACEBACK, *(word for word in words if word != TRACEBACK)]
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    try:
        app(words, prog_name="armctl")
    except ArmctlError as error:
        from rich.text import Text

        from armctl.core.console import PlainConsole, printable

        if settings.traceback:
            print(printable(format_cause(error)), file=sys.stderr)
        console = PlainConsole(stderr=True)  # a terminal breaks lines within words, and a file has its own width
        console.print(Text.assemble(("armctl: ", "red"), str(error)), soft_wrap=not console.is_terminal)
        sys.exit(2)
    finally:
        _watch_threads(earlier)
    sys.exit(0)


def _watch_threads(earlier: Set[threading.Thread]) -> None:
    """Name threads that somebody's code has started and that keep this process from its end; Ctrl-C ends them.

    That of armctl's own workers is told to end when Python itself ends, after this.
    """
    others = [thread for thread in threading.enumerate() if not type(thread).__module__.startswith("joblib.")]
    waiting = [thread for thread in others if not thread.daemon and thread not in earlier]
    if waiting:
        handler = signal.getsignal(signal.SIGINT)

        def end(number: int, frame: FrameType | None) -> None:
            if not threading.main_thread().is_alive():
                os._exit(INTERRUPTED)
            if callable(handler):
                handler(number, frame)

        signal.signal(signal.SIGINT, end)
        threading.Thread(target=_name_threads, args=(waiting,), daemon=True).start()


def _name_threads(waiting: Sequence[threading.Thread]) -> None:
    time.sleep(PATIENCE)
    threads = [thread for thread in waiting if thread.is_alive()]
    if threads and not threading.main_thread().is_alive():  # Python waits for them at its end
        of = f"threads of an environment or a policy run on, such as {threads[0].name!r}"
        print(f"armctl has finished; {of}: Ctrl-C ends them", file=sys.stderr, flush=True)
