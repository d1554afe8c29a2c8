"""Tables and progress bars of the benchmarks."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

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


def show_simulations(
    tables: Mapping[str, tuple[Callable[[int], Iterable[Any]], Sequence[str]]], runs: int, table: str
) -> None:
    """Simulate, and print each of the tables; of a named `table`, only that."""
    for name, (simulate, columns) in tables.items():
        if table and name != table:
            continue
        start, printed = time.process_time(), markdown_table(*columns)
        for row in simulate(runs):
            printed.add_row(*row)
        show(printed)
        print(f"{name}: {runs} runs, armctl {armctl.__version__}, {time.process_time() - start:.0f} s of processor\n")
