"""What the terminal shows."""

import io

from rich.console import Console

from armctl.report.terminal import tables


def text_of(comparison):
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(tables(comparison))
    return console.export_text()
