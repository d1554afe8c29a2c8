"""Documents as Markdown, LaTeX, JSON and CSV: for papers, pages and programs."""

import csv
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from armctl.verdict.tables import AGAINST, Cell, Document, Table

LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
}  # fmt: skip
"""Characters that LaTeX would interpret, and how they are written."""
NUMBERS = re.compile(r"[-+<%/. \de]+|[-+.\de]+ to [-+.\de]+")
"""A number, or an interval, and nothing that is a name."""
EXPONENT = re.compile(r"e([-+]?\d+)")
MARKDOWN = re.compile(r"([\\`*_{}\[\]<>|#])")
"""Characters that Markdown would interpret."""


def markdown(document: Document) -> str:
    """Tables with pipes; intervals stand in brackets behind their values."""
    parts = []
    for part in document.parts:
        if isinstance(part, Table):
            headings = [markdown_text(column.heading) for column in part.columns]
            rules = [":--", *["--:"] * (len(headings) - 1)]
            rows = [[markdown_text(_in_one_line(cell)) for cell in row] for row in part.rows]
            lines = "\n".join(f"| {' | '.join(line)} |" for line in (headings, rules, *rows))
            parts.append(f"**{markdown_text(part.title)}**\n\n{lines}\n\n{markdown_text(part.caption)}".rstrip())
        else:
            parts.append(f"**{markdown_text(part.text)}**" if part.kind == "verdict" else markdown_text(part.text))
    return "\n\n".join(parts) + "\n"


def latex(document: Document) -> str:
    """Tables for the package booktabs; intervals stand beneath their values. Remarks are comments."""
    lines = [r"% in the preamble: \usepackage{booktabs}"]
    for part in document.parts:
        if not isinstance(part, Table):
            lines += [f"% {line}" for line in part.text.splitlines()]
            continue
        columns = "l" + "r" * (len(part.columns) - 1)
        lines += [
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{_latex(f'{part.title}. {part.caption}'.strip())}}}",
            rf"  \begin{{tabular}}{{{columns}}}",
            r"    \toprule",
            f"    {_latex_row(_latex(column.heading) for column in part.columns)}",
            r"    \midrule",
        ]
        for i, row in enumerate(part.rows):
            small = any(cell.small for cell in row)
            lines += [r"    \addlinespace"] if i and small else []
            lines.append(f"    {_latex_row(_latex_value(cell.text) for cell in row)}")
            if small:
                beneath = (rf"\footnotesize {_latex_value(cell.small)}" if cell.small else "" for cell in row)
                lines.append(f"    {_latex_row(beneath)}")
        lines += [r"    \bottomrule", r"  \end{tabular}", r"\end{table}"]
    return "\n".join(lines) + "\n"


def as_json(document: Document) -> str:
    """Return JSON: what was done, the records of all tables by key, verdict and remarks. Unknown numbers are null."""
    records: dict[str, list[Any]] = {}
    for table in document.tables:
        records.setdefault(table.key, []).extend(_jsonable(record) for record in table.records)
    texts: dict[str, list[str]] = {"verdict": [], "remarks": []}
    for part in document.parts:
        if not isinstance(part, Table):
            texts["verdict" if part.kind == "verdict" else "remarks"].append(part.text)
    verdict = {"verdict": " ".join(texts["verdict"]) or None}
    return json.dumps({**document.head, **records, **verdict, "remarks": texts["remarks"]}, indent=2) + "\n"


def as_csv(document: Document) -> str:
    """Return the records of all tables as one table, in whose first column is the key of each."""
    rows = [{"table": table.key, **_flat(record)} for table in document.tables for record in table.records]
    out = io.StringIO()
    writer = csv.DictWriter(out, list(dict.fromkeys(name for row in rows for name in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue()


FORMATS: Mapping[str, Callable[[Document], str]] = {
    "markdown": markdown, "latex": latex, "json": as_json, "csv": as_csv,
}  # fmt: skip
"""Besides `table`, which is the terminal's."""


def _in_one_line(cell: Cell) -> str:
    """Return a cell's text with its small print: an interval in brackets, the rest behind a comma."""
    if not cell.small:
        return cell.text
    if " to " in cell.small:
        return f"{cell.text} [{cell.small}]"
    return f"{cell.text} {cell.small}" if cell.small.startswith(AGAINST) else f"{cell.text}, {cell.small}"


def markdown_text(text: str) -> str:
    """Return a text in which Markdown interprets nothing."""
    return MARKDOWN.sub(r"\\\1", text)


def _latex(text: str) -> str:
    return "".join(LATEX.get(letter, letter) for letter in text)


def _latex_value(text: str) -> str:
    """Text escaped; a number with a minus sign, and with its exponent as a power of ten."""
    if NUMBERS.fullmatch(text) is None:
        return _latex(text)
    text = EXPONENT.sub(lambda match: rf"$\times10^{{{int(match[1])}}}$", _latex(text))
    return re.sub(r"(?<![\w{])-(?=[\d.])", "$-$", text)


def _latex_row(cells: Iterable[str]) -> str:
    return " & ".join(cells) + r" \\"


def _flat(record: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten a record: an estimate's value keeps its name, and its bounds are `name_low` and `name_high`."""
    flat: dict[str, Any] = {}
    for name, value in record.items():
        if isinstance(value, Mapping):
            inner = _flat(value)
            flat |= {name if part == "value" else f"{name}_{part}": number for part, number in inner.items()}
        else:
            flat[name] = "" if value is None or (isinstance(value, float) and math.isnan(value)) else value
    return flat


def _jsonable(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _jsonable(part) for name, part in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_jsonable(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
