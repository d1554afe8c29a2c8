"""Results as tables and remarks, which terminal, notebook and files show in their own way.

A `Document` is what `armctl compare`, `sweep` and `reproduce` print. `armctl.report.terminal` renders it for terminals,
`armctl.report.formats` as Markdown, LaTeX, JSON and CSV, and `armctl.verdict.notebook` for notebooks.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from armctl.stats.intervals import Estimate

UNKNOWN = "-"
"""Text of a cell without a value."""
AGAINST = "- "
"""Text before the second policy's name in the name of a difference."""
MIN_P_VALUE = 1e-300
"""About the smallest p-value that a floating-point number can hold."""
_LINE_ENDS = re.compile(r"[\n\r\v\f\x1c-\x1e\x85\u2028\u2029]")


class _InLines:
    """Texts without line ends, which are written as in Python: a name from a file breaks no row of a table."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, str):
                one_line = _LINE_ENDS.sub(lambda end: end[0].encode("unicode_escape").decode(), value)
                object.__setattr__(self, name, one_line)


@dataclass(frozen=True)
class Cell(_InLines):
    """The text of a value, and beneath it the small print, such as its interval."""

    text: str
    small: str = ""


@dataclass(frozen=True)
class Column(_InLines):
    """The heading of a column."""

    heading: str
    optional: bool = False
    """True if it may be left out where there is no room for all columns."""


@dataclass(frozen=True)
class Table(_InLines):
    """Rows of cells; the first cell of each is its name."""

    key: str
    """The name of `records` in JSON and CSV."""
    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    records: Sequence[Mapping[str, Any]]
    """The same for programs: plain numbers by name, all digits, with everything that the cells have no room for."""
    caption: str = ""


@dataclass(frozen=True)
class Remark(_InLines):
    """A sentence between tables."""

    text: str
    kind: Literal["detail", "verdict", "note", "problem"] = "detail"


@dataclass(frozen=True)
class Document:
    """Tables and remarks, in the order in which they are read."""

    parts: Sequence[Table | Remark]
    head: Mapping[str, Any] = field(default_factory=dict)
    """Settings by name, for programs."""

    @property
    def tables(self) -> list[Table]:
        """The tables."""
        return [part for part in self.parts if isinstance(part, Table)]


def plain(estimate: Estimate | None, sign: str = "") -> Cell:
    """Return a value above its interval; `sign` is "+" for differences."""
    if estimate is None or math.isnan(estimate.value):
        return Cell(UNKNOWN)
    decimals = _decimals(value for value in (estimate.value, estimate.low, estimate.high) if value is not None)
    return Cell(_short(estimate.value, decimals, sign), _interval(estimate.low, estimate.high, decimals, sign))


def percent(estimate: Estimate | None, sign: str = "") -> Cell:
    """Return a share above its interval, both in percent; `sign` is "+" for differences."""
    if estimate is None:
        return Cell(UNKNOWN)
    low, high = (None if bound is None else 100 * bound for bound in (estimate.low, estimate.high))
    return Cell(f"{100 * estimate.value:{sign}.1f} %", _interval(low, high, 1, sign))


def points(difference: Estimate) -> str:
    """Return a difference in success in points, with its interval."""
    value, low, high = (100 * share + 0.0 for share in (difference.value, *difference.bounds))
    return f"{value:+.1f} points [{low:.1f}, {high:.1f}]"


def size(difference: Estimate) -> str:
    """Return the size of a difference, whatever its sign, with its interval, which does not contain 0."""
    low, high = sorted(map(abs, difference.bounds))
    return f"{abs(difference.value):.1f} [{low:.1f}, {high:.1f}]"


def p_value(p: float | None) -> str:
    """Return a p-value with two digits, in exponential form if it is small."""
    if p is None:
        return UNKNOWN
    return f"{p:.2g}" if p > MIN_P_VALUE else f"< {MIN_P_VALUE:g}"


def milliseconds(value: float) -> str:
    """Return a time, ms, with at least two digits and its unit."""
    return f"{value:,.0f} ms" if value >= 99.5 else f"{value:.2g} ms"


def _interval(low: float | None, high: float | None, decimals: int, sign: str) -> str:
    if low is None or high is None:
        return "unknown"
    return f"{_short(low, decimals, sign)} to {_short(high, decimals, sign)}"


def _decimals(values: Any) -> int:
    """Decimals of numbers that are read together: one, or so many that the largest has two digits."""
    largest = max((abs(value) for value in values if math.isfinite(value)), default=0.0)
    return 1 if largest == 0 or largest >= 1 else min(1 - math.floor(math.log10(largest)), 9)


def _short(value: float, decimals: int, sign: str) -> str:
    if abs(value) >= 1e6:
        return f"{value:{sign}.3g}"
    return f"{value:{sign}.{0 if abs(value) >= 99.95 else decimals}f}"
