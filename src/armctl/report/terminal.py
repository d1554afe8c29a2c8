"""Tables for the terminal, in which no number is ever cut.

Where there is no room, names are shortened, optional columns are left out, and at last cells are stacked.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from rich.box import SIMPLE_HEAD
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table as RichTable
from rich.text import Text

from armctl.core.console import PlainConsole
from armctl.verdict.notebook import Displayed
from armctl.verdict.tables import AGAINST, Cell, Document, Remark, Table

SHORTEST_NAME = 18
"""Characters that are left of a shortened name."""
GAP = 2
"""Characters between two columns: one of padding, one of the box."""
UNLIMITED = 10_000
"""Width of what is not a terminal."""
STYLES = {"detail": "", "verdict": "bold", "note": "yellow", "problem": "red"}


def output_console() -> PlainConsole:
    """Standard output. Where it is not a terminal, it is as wide as its lines, unless the variable COLUMNS is set."""
    limited = sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()
    return PlainConsole(width=None if limited else UNLIMITED)


def tables(displayed: Displayed) -> "DocumentView":
    """Return the tables and remarks of a comparison or a sweep."""
    return DocumentView(displayed.document())


@dataclass(frozen=True)
class DocumentView:
    """A document that Rich can print, at the width that there is."""

    document: Document

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        above: Table | Remark | None = None
        for part in self.document.parts:
            if above and (isinstance(part, Table) or (part.kind == "verdict" and _kind(above) != "verdict")):
                yield Text()
            if isinstance(part, Table):
                yield from _render_table(part, options.max_width)
            else:
                yield Text(part.text, style=STYLES[part.kind])
            above = part


def _kind(part: Table | Remark) -> str:
    return "table" if isinstance(part, Table) else part.kind


def _render_table(table: Table, width: int) -> Iterator[Text | RichTable]:
    yield Text(table.title, style="italic")
    fitted, left_out = fitted_table(table, width)
    yield _stacked(table, width) if fitted is None else _side_by_side(fitted)
    caption = table.caption
    if left_out:
        caption += f" Left out at this width: {', '.join(left_out)}."
    if caption:
        yield Text(caption.strip(), style="dim italic")


def fitted_table(table: Table, width: int) -> tuple[Table | None, list[str]]:
    """Return the table in a form that is at most `width` wide, and the headings that were left out for it.

    Names are shortened, as far as they stay distinct; then optional columns are left out, beginning with the last. The
    table is None if that is not enough.
    """
    kept, left_out = list(range(len(table.columns))), list[str]()
    while True:
        columns = [table.columns[i] for i in kept]
        rows = [[row[i] for i in kept] for row in table.rows]
        numbers = sum(GAP + _width([Cell(columns[i].heading), *(row[i] for row in rows)]) for i in range(1, len(kept)))
        names = _shortened(table, width - numbers)
        if names is not None:
            named = [[name, *row[1:]] for name, row in zip(names, rows, strict=True)]
            return replace(table, columns=columns, rows=named), left_out[::-1]
        optional = [i for i in kept if table.columns[i].optional]
        if not optional:
            return None, []
        kept.remove(optional[-1])
        left_out.append(table.columns[optional[-1]].heading)


def _shortened(table: Table, width: int) -> list[Cell] | None:
    """Return the names of rows, at most `width` wide and as distinct as before; None if that is impossible."""
    names = [row[0] for row in table.rows]
    fixed = [cell.small for cell in names if not cell.small.startswith(AGAINST)]
    if width < max(map(cell_len, (table.columns[0].heading, *fixed))):
        return None
    if _width(names) <= width:
        return names
    if width < SHORTEST_NAME:
        return None
    short = [Cell(_tail(cell.text, width), _tail(cell.small, width)) for cell in names]
    return short if len(set(short)) == len(set(names)) else None


def _tail(name: str, width: int) -> str:
    """Return the end of a name, which tells more than its beginning; AGAINST stays before it."""
    if cell_len(name) <= width:
        return name
    prefix = AGAINST if name.startswith(AGAINST) else ""
    tail = name.removeprefix(prefix)
    while cell_len(prefix + "…" + tail) > width:
        tail = tail[1:]
    return prefix + "…" + tail


def _width(cells: Sequence[Cell]) -> int:
    return max(max(cell_len(cell.text), cell_len(cell.small)) for cell in cells)


def _side_by_side(table: Table) -> RichTable:
    rich_table = RichTable(box=SIMPLE_HEAD, padding=(0, GAP - 1, 0, 0), show_edge=False, pad_edge=False)
    for i, column in enumerate(table.columns):
        rich_table.add_column(Text(column.heading), justify="right" if i else "left", no_wrap=True)
    for row in table.rows:
        rich_table.add_row(*(Text(f"{cell.text}\n{cell.small}" if cell.small else cell.text) for cell in row))
    return rich_table


def _stacked(table: Table, width: int) -> Text:
    """Each row as lines of headings and values, for widths at which they have no room side by side."""
    heading_width = max(cell_len(column.heading) for column in table.columns)
    lines = []
    for row in table.rows:
        lines.append(f"{table.columns[0].heading}: {row[0].text} {row[0].small}".rstrip())
        for column, cell in zip(table.columns[1:], row[1:], strict=True):
            heading = column.heading + " " * (heading_width - cell_len(column.heading))
            small = cell.small and f" ({cell.small})"
            if cell_len(f"  {heading} {cell.text}{small}") > width:
                small = f"\n  {' ' * heading_width} {small.strip()}"
            lines.append(f"  {heading} {cell.text}{small}")
    return Text("\n".join(lines))
