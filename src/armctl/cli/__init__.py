"""The verbs of the command line. No logic of their own: each calls the library."""

import os
import sys
import threading
import time
from collections.abc import Set
from typing import NoReturn

from armctl.cli import catalogue, compare, evaluate, export, learn, new, play, share, tune
from armctl.cli.app import app, settings
from armctl.core.errors import ArmctlError, format_cause

__all__ = ["app", "catalogue", "compare", "evaluate", "export", "learn", "main", "new", "play", "share", "tune"]

TRACEBACK = "--traceback"
PATIENCE = 2.0
"""s for threads to end with the process before they are named."""


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
        _wait_for_threads(earlier)
    sys.exit(0)


def _wait_for_threads(earlier: Set[threading.Thread]) -> None:
    """Name threads that somebody's code has started and that keep this process from its end; Ctrl-C ends them."""
    waiting = [thread for thread in threading.enumerate() if not thread.daemon and thread not in earlier]
    latest = time.monotonic() + PATIENCE
    for thread in waiting:
        thread.join(max(0.0, latest - time.monotonic()))
    if not (running := [thread for thread in waiting if thread.is_alive()]):
        return
    sys.stdout.flush()
    of = f"{len(running)} threads of an environment or a policy run on, such as {running[0].name!r}"
    try:
        print(f"armctl has finished; {of}: Ctrl-C ends them", file=sys.stderr, flush=True)
        for thread in running:
            thread.join()
    except KeyboardInterrupt:
        os._exit(130)
