"""Tables as text: CSV, TSV, and what spreadsheets make of them."""

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from armctl.core.errors import ConfigurationError
from armctl.core.files import bounded_bytes
from armctl.judging import log
from armctl.judging.formats import sb3
from armctl.judging.rows import Rows

LARGEST = 256 * 2**20
"""Bytes of a file."""
DELIMITERS = ";\t,|"
COMMENT = "#"
SIGNATURES = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def read(path: Path) -> list[Rows]:
    """Read a table whose first line names its columns. Raises `ConfigurationError`, `OSError` or `ValueError`."""
    source, notes = str(path), list[str]()
    text = _decoded(bounded_bytes(path, LARGEST), notes)
    delimiter, header, lines = _lines(text)
    if not lines:
        raise ConfigurationError(f"{source} is empty: its first line should name the columns")
    delimiter = delimiter or max(DELIMITERS, key=lines[0][1].count)
    records = list(_records(source, lines, delimiter))
    headings = [cell.strip() for cell in records[0][1]]
    while headings and not headings[-1]:
        headings.pop()
    rows = [(number, cells) for number, cells in records[1:] if any(cell.strip() for cell in cells)]
    comments = [number for number, cells in rows if cells[0].lstrip().startswith(COMMENT)]
    if comments:
        notes.append(f"{len(comments)} comments skipped, the first in line {comments[0]}.")
    rows = [(number, cells) for number, cells in rows if number not in set(comments)]
    values = [_fitted(source, number, cells, len(headings)) for number, cells in rows]
    table = Rows(
        source=source, headings=headings, values=values, places=[number for number, _ in rows], notes=notes,
        delimiter=delimiter,
    )  # fmt: skip
    if log.FORMAT in header or headings == [*log.COLUMNS]:  # also if the comment was deleted
        log.check_readable(source, header, len(rows))
        task = {"task": str(header["task"])} if header.get("task") else {}
        return [replace(table, is_known_format=True, any_number=True, constants=task)]
    return [sb3.monitor(path, table, header) if "t_start" in header else table]


def _lines(text: str) -> tuple[str, dict[str, object], list[tuple[int, str]]]:
    """Return a stated delimiter, the values of a comment before the table, and its lines with their numbers."""
    delimiter, header, lines = "", dict[str, object](), list[tuple[int, str]]()
    for number, line in enumerate(io.StringIO(text, newline=None), 1):
        if line.startswith("sep=") and not lines and len(line.strip()) == 5:
            delimiter = line[4]
        elif line.startswith(COMMENT) and not lines:
            header |= _header(line)
        elif line.strip() or lines:
            lines.append((number, line))
    return delimiter, header, lines


def _decoded(content: bytes, notes: list[str]) -> str:
    encoding = next((name for mark, name in SIGNATURES.items() if content.startswith(mark)), None)
    if encoding is None:
        nulls = content[:200].count(0)
        encoding = "utf-8" if not nulls else "utf-16-le" if content[1:200:2].count(0) > nulls / 2 else "utf-16-be"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:
        if encoding != "utf-8":
            raise
        text = content.decode("cp1252")
        notes.append("not UTF-8: its letters are read as those of Windows (code page 1252).")
    if "\0" in text:
        raise ValueError("it is no text")
    return text


def _header(line: str) -> dict[str, object]:
    """Return the values of a comment that is a JSON object, as Stable-Baselines3 writes it; of another, nothing."""
    try:
        values = json.loads(line[1:])
    except ValueError:
        return {}
    return values if isinstance(values, dict) else {}


def _records(source: str, lines: list[tuple[int, str]], delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Return the cells of each line, or of several if a quoted cell has line ends, with the number of the first."""
    reader = csv.reader((line for _, line in lines), delimiter=delimiter, strict=True, skipinitialspace=True)
    while True:
        first = reader.line_num
        try:
            cells = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            place = lines[min(first, len(lines) - 1)][0]
            raise ConfigurationError(f"{source}, line {place}: {_why(str(error))}") from None
        yield lines[first][0], cells or [""]


def _why(error: str) -> str:
    return 'a quotation mark (") opens here, and none closes it' if "end of data" in error else error


def _fitted(source: str, number: int, cells: list[str], columns: int) -> list[str]:
    """Return as many cells as there are columns: short rows lack their last ones, and long ones have empty ones."""
    if any(cell.strip() for cell in cells[columns:]):
        raise ConfigurationError(
            f"{source}, line {number}: it has {len(cells)} cells, more than the {columns} columns that the first line "
            "names; a cell with a delimiter in it needs quotation marks"
        )
    return cells[:columns] + [""] * (columns - len(cells))
