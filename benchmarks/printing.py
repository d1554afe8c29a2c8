"""Tables and progress bars of the benchmarks."""

from collections.abc import Iterable
from typing import TypeVar

from rich.box import MARKDOWN
from rich.console import Console, RenderableType
from rich.progress import track
from rich.table import Table

import armctl

T = TypeVar("T")


def markdown_table(*columns: str, title: str | None = None) -> Table:
    """Return a table without rows, as `docs/` have it."""
    return Table(*columns, title=title, title_justify="left", box=MARKDOWN)


def versioned_table(*columns: str) -> Table:
    """Return a table without rows that names armctl's version."""
    return markdown_table(*columns, title=f"armctl {armctl.__version__}")


def show(*parts: RenderableType, width: int | None = None) -> None:
    """Print tables and texts below each other, by default as wide as the terminal."""
    Console(width=width).print(*parts, sep="\n")


def progress(items: Iterable[T], label: str = "Working...") -> Iterable[T]:
    """Yield the items, and show how many are done, on the error stream."""
    return track(items, label, console=Console(stderr=True), transient=True)
