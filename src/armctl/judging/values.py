"""Values of cells: success in words, and numbers as people type them."""

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any

YES = {"1", "1.0", "true", "t", "yes", "y", "success", "successful", "succeeded", "pass", "passed", "ok", "won", "win",
       "solved", "done", "ja", "j", "oui", "o", "si", "sí", "s", "✓", "✔", "☑", "✅"}  # fmt: skip
NO = {"0", "0.0", "false", "f", "no", "n", "failure", "fail", "failed", "unsuccessful", "lost", "loss", "nok", "error",
      "timeout", "nein", "non", "✗", "✘", "☐", "❌"}  # fmt: skip
EMPTY = {"", "nan", "na", "n/a", "none", "null", "-", "\u2013", "?", "#n/a"}
"""Texts of a cell in which nothing was entered."""
NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)(e[+-]?\d+)?", re.IGNORECASE)
GROUPS = re.compile(r"(?<=\d)[ \u00a0\u2009\u202f'\u2019](?=\d{3}(?!\d))")
"""Separators of thousands that are never a decimal sign."""
POINTS_OR_COMMAS = re.compile(r"[+-]?\d{1,3}((?P<sign>[.,])\d{3})(\2\d{3})*", re.ASCII)
UNDIVIDED = re.compile(r"[+-]?\d{4,}", re.ASCII)
COUNTS = re.compile(r"(\d+)\s*(?:/|of|von|out of)\s*(\d+)", re.IGNORECASE)


def is_empty(cell: Any) -> bool:
    """Return True if nothing was entered."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return True
    return isinstance(cell, str) and cell.strip().lower() in EMPTY


def truth(cell: Any) -> bool:
    """Return success as a cell says it. Raises `ValueError` for anything that is not clear."""
    if isinstance(cell, bool):
        return cell
    if hasattr(cell, "item"):
        cell = cell.item()
    if isinstance(cell, int | float):
        if cell in (0, 1):
            return bool(cell)
        rate = 0 < cell <= 100 and "a rate rather than one episode's success: a row is needed for each episode"
        raise ValueError(f"{cell:g} is {rate or 'neither 0 nor 1'}")
    text = str(cell).strip().lower()
    if text in YES or text in NO:
        return text in YES
    number = text.rstrip("% ").replace(",", ".")
    if NUMBER.fullmatch(number):
        if not text.endswith("%"):
            return truth(float(number))
        raise ValueError(f"{text} is a rate rather than one episode's: a row is needed for each episode")
    raise ValueError(f"{str(cell)!r:.60} is neither yes nor no")


def counts(cell: Any) -> tuple[int, int] | None:
    """Return successes and trials of a cell such as `17/20`; None for any other. Raises `ValueError` for `21/20`."""
    match = COUNTS.fullmatch(cell.strip()) if isinstance(cell, str) else None
    if match is None:
        return None
    won, trials = int(match[1]), int(match[2])
    if won > trials or not 0 < trials <= 1_000_000:
        raise ValueError(f"{cell.strip()}: there cannot be {won} successes in {trials} trials")
    return won, trials


def decimal_signs(cells: Iterable[Any]) -> dict[str, str]:
    """Return a text that shows each decimal sign in use: by itself, `1,234` shows none, and `1.234` neither."""
    examples: dict[str, str] = {}
    for cell in cells:
        if isinstance(cell, str) and ("," in cell or "." in cell):
            text = GROUPS.sub("", cell.strip())
            grouped = POINTS_OR_COMMAS.fullmatch(text)
            last = max(",.", key=text.rfind)
            if grouped and not text.lstrip("+-").startswith("0"):
                if text.count(last) > 1:
                    examples.setdefault(",."[last == ","], cell.strip())
            else:
                examples.setdefault(last, cell.strip())
    return examples


def numbers(cells: Sequence[Any], sign: str | None, unclear: str = ",") -> list[float | str | None]:
    """Return the number in each cell, None for an empty one, and why for one that has none.

    `sign` is the decimal sign of the file, None if nothing shows it; `unclear` are signs that may then divide
    thousands, of which the point does not in a column that has a thousand without one.
    """
    if any(isinstance(cell, str) and UNDIVIDED.fullmatch(cell.strip()) for cell in cells):
        unclear = unclear.replace(".", "")
    values: list[float | str | None] = []
    for cell in cells:
        if isinstance(cell, int | float) and not isinstance(cell, bool):
            values.append(None if is_empty(cell) else float(cell))
        elif is_empty(cell):
            values.append(None)
        else:
            values.append(_number(str(cell).strip() if isinstance(cell, str) else str(cell), sign, unclear))
    return values


def _number(text: str, sign: str | None, unclear: str) -> float | str:
    plain = GROUPS.sub("", text.replace("\u2212", "-"))
    if POINTS_OR_COMMAS.fullmatch(plain) and not plain.lstrip("+-").startswith("0"):
        last = max(",.", key=plain.rfind)
        if sign is None and last in unclear and plain.count(last) == 1:
            name = {",": "comma", ".": "point"}[last]
            return f"{text} may be {plain.replace(',', '.')} or {plain.replace(last, '')}: write it without a {name}"
        if sign not in (None, last) or plain.count(last) > 1:
            plain = plain.replace(last, "")
    thousands = {".": ",", ",": "."}.get(sign or ".", "")
    if thousands in plain and re.fullmatch(rf"[+-]?\d{{1,3}}(\{thousands}\d{{3}})+(\{sign or '.'}\d*)?", plain):
        plain = plain.replace(thousands, "")
    if NUMBER.fullmatch(plain):
        return float(plain.replace(",", "."))
    return f"{text!r:.60} is not a number"
