"""The verbs of the command line. No logic of their own: each calls the library."""

import os
import sys
from typing import NoReturn

from armctl.cli import catalogue, compare, evaluate, export, learn, new, play, share, tune
from armctl.cli.app import app, settings
from armctl.core.errors import ArmctlError, format_cause

__all__ = ["app", "catalogue", "compare", "evaluate", "export", "learn", "main", "new", "play", "share", "tune"]

TRACEBACK = "--traceback"


def main() -> NoReturn:
    """Run the command line; armctl's own errors become one line and exit status 2."""
    os.environ["PYTHONSAFEPATH"] = "1"  # worker processes import nothing from the working directory either
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
    sys.exit(0)
