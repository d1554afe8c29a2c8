"""Columns of rows as values of their types: names, success, numbers. Whatever is not clear is refused."""

import contextlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from armctl.core.errors import ConfigurationError
from armctl.episodes.record import LARGEST_RETURN
from armctl.judging.columns import SCORES
from armctl.judging.rows import Rows
from armctl.judging.values import counts, decimal_signs, is_empty, numbers, truth

NUMBERS = ("return", "time", "steps", "decision_ms", "training_steps")
KEYS = ("training_seed", "seed", "episode")
NAMES = ("policy", "task", "condition", *KEYS)
DAY = 86_400
"""s, the longest time of an episode."""
SUMMARIES = {"total", "totals", "subtotal", "sum", "mean", "average", "avg", "median", "std", "summary", "overall",
             "gesamt", "summe", "mittelwert", "durchschnitt", "moyenne", "total general", "grand total"}  # fmt: skip
"""Names of rows that sum up others."""
NUMERAL = re.compile(r"[+-]?\d+(\.\d*)?", re.ASCII)


def typed_columns(
    rows: Rows, columns: Mapping[str, int], default_policy: str
) -> tuple[dict[str, list[Any]], list[str]]:
    """Return the values of each field that is known, and what was assumed.

    `success` is a list of values for each row, which may count several trials.

    Raises `ConfigurationError` with file, line and reason for a value that is not clear.
    """
    cells: dict[str, list[Any]] = {name: [row[place] for row in rows.values] for name, place in columns.items()}
    for name, value in ({"policy": default_policy} | dict(rows.constants)).items():
        cells.setdefault(name, [value] * len(rows.values))
    notes: list[str] = []
    signs = decimal_signs(cell for name in NUMBERS for cell in cells.get(name, ()))
    if len(signs) > 1:
        raise ConfigurationError(
            f"{rows.source}: both the comma ({signs[',']}) and the point ({signs['.']}) are used as decimal signs"
        )
    if "," in signs:
        notes.append(f"the comma is the decimal sign, as in {signs[',']}.")
    values = {name: _numbers(rows, name, cells[name], next(iter(signs), None)) for name in NUMBERS if name in cells}
    required = next(name for name in SCORES if name in columns)
    for name in ("return", "time"):
        if name in values:
            _check_gaps(rows, name, values, cells, name == required, notes)
    values |= {name: _names(rows, name, cells[name]) for name in NAMES if name in cells}
    if "feasible" in cells:
        values["feasible"] = [won for (won,) in _successes(rows, cells["feasible"], "feasible")]
    if "success" in cells:
        values["success"] = _successes(rows, cells["success"])
        if any(len(each) > 1 for each in values["success"]):
            notes.append("counts of successes, such as 17/20, stand for as many episodes each.")
    return values, notes


def _numbers(rows: Rows, name: str, cells: Sequence[Any], sign: str | None) -> list[Any]:
    """Return the numbers of a column, None where there is none."""
    unclear = "," if rows.delimiter == "," or rows.is_known_format else ",."
    label, values = name.replace("_", " "), numbers(cells, sign, unclear)
    for i, value in enumerate(values):
        if isinstance(value, str):
            rows.refuse(i, f"{label}: {value}")
        if value is None:
            continue
        if not abs(value) <= LARGEST_RETURN:
            rows.refuse(i, f"{label}: {value:g} is no number to compare")
        elif value < 0 and name != "return":
            rows.refuse(i, f"{label}: {value:g} is less than 0")
        elif name == "time" and value > DAY:
            rows.refuse(
                i, f"time: {value:g} s is more than a day: if it is a date, name the duration, --time-column NAME"
            )
        elif name == "steps" and value % 1:
            rows.refuse(i, f"steps: {value:g} is not a whole number")
    if name.endswith("steps"):
        return [None if value is None else int(value) for value in values]
    return values


def _check_gaps(
    rows: Rows,
    name: str,
    values: dict[str, list[Any]],
    cells: Mapping[str, list[Any]],
    required: bool,
    notes: list[str],
) -> None:
    """Refuse an empty return or time if the verdict rests on it; else leave the column out. A failure needs no time."""
    gaps = [i for i, value in enumerate(values[name]) if value is None]
    if name == "time" and not required:
        gaps = [i for i in gaps if _won(cells["success"][i])] if "success" in cells else gaps
    if gaps and required:
        rows.refuse(gaps[0], f"the {name} is empty: enter it, or remove the row")
    if gaps:
        where = f"the first in {rows.unit} {rows.places[gaps[0]]}"
        if len(gaps) < len(rows.values):
            notes.append(f"the {name} is not used, since it is empty in {len(gaps)} rows, {where}.")
        del values[name]


def _won(cell: Any) -> bool:
    with contextlib.suppress(ValueError):
        return truth(cell)
    return True


def _names(rows: Rows, name: str, cells: Sequence[Any]) -> list[str]:
    """Return names without spaces around them; whole numbers without a point. A whole column may be empty."""
    if name != "policy" and all(map(is_empty, cells)):
        return [""] * len(cells)
    texts = []
    for i, cell in enumerate(cells):
        if is_empty(cell) and str(cell).strip().lower() != "none":
            rows.refuse(i, f"the {name.replace('_', ' ')} is empty")
        is_whole = isinstance(cell, float) and cell.is_integer()
        texts.append(str(int(cell)) if is_whole else " ".join(str(cell).split()))
    if not rows.is_known_format:
        _check_summaries(rows, name, texts)
    if name in KEYS and all(map(NUMERAL.fullmatch, texts)):
        return [str(int(text)) if text.isdecimal() else repr(float(text)).removesuffix(".0") for text in texts]
    return texts


def _check_summaries(rows: Rows, name: str, texts: Sequence[str]) -> None:
    """Refuse a row that sums up others: by its name, which as a policy's would be rarer than others."""
    counts = Counter(texts)
    for i, text in enumerate(texts):
        if text.casefold().rstrip(":") in SUMMARIES and (name != "policy" or counts[text] < max(counts.values())):
            rows.refuse(i, f"{text!r} as {name.replace('_', ' ')} sums up other rows: remove the row, or rename it")


def _successes(rows: Rows, cells: Sequence[Any], name: str = "success") -> list[tuple[bool, ...]]:
    """Return the success of each row, or of the several trials that it counts."""
    successes: list[tuple[bool, ...]] = []
    for i, cell in enumerate(cells):
        try:
            if is_empty(cell):
                raise ValueError("empty: enter yes or no, or remove the row")
            won, trials = counts(cell) or (int(truth(cell)), 1)
            successes.append((True,) * won + (False,) * (trials - won))
        except ValueError as error:
            rows.refuse(i, f"{name}: {error}")
    return successes
