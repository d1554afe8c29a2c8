"""The verbs of the command line. No logic of their own: each calls the library."""

import sys
from typing import NoReturn

from armctl.cli import catalogue, evaluate, learn, play
from armctl.cli.app import app
from armctl.errors import ArmctlError

__all__ = ["app", "catalogue", "evaluate", "learn", "main", "play"]


def main() -> NoReturn:
    """Run the command line; armctl's own errors become one line and exit status 2."""
    try:
        app(prog_name="armctl")
    except ArmctlError as error:
        from rich.console import Console
        from rich.text import Text

        Console(stderr=True).print(Text.assemble(("armctl: ", "red"), str(error)), soft_wrap=True)
        sys.exit(2)
    sys.exit(0)
