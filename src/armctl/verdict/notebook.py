"""Results in notebooks: small HTML tables in the notebook's colours, light or dark."""

import html
from abc import ABC, abstractmethod
from collections.abc import Sequence

from armctl.verdict.tables import Cell, Document, Remark, Table

TABLE = "border-collapse: collapse; margin: 0; color: inherit; font-size: inherit; font-variant-numeric: tabular-nums;"
CELL = "padding: 3px 0 3px 18px; text-align: {align}; vertical-align: top; border: 0; white-space: nowrap;"
RULE = "border-bottom: 1px solid color-mix(in srgb, currentColor {share}%, transparent);"
SMALL = "font-size: 85%; opacity: .7;"
KINDS = {
    "detail": SMALL,
    "verdict": "font-weight: 600;",
    "note": "border-left: 3px solid #d97706; padding-left: 10px;",
    "problem": "border-left: 3px solid #dc2626; padding-left: 10px;",
}
"""Styles of remarks. Colours are those of the notebook, but for bars that are seen on white and on black."""


class Displayed(ABC):
    """Base of results that notebooks display as a document."""

    @abstractmethod
    def document(self) -> Document:
        """Return the tables and remarks."""

    def _repr_html_(self) -> str:
        """Return the document as HTML, for Jupyter."""
        return html_of(self.document())


def html_of(document: Document) -> str:
    """Return a document as HTML without scripts, style sheets and links."""
    parts = [_table(part) if isinstance(part, Table) else _remark(part) for part in document.parts]
    return f'<div class="armctl" style="line-height: 1.4; overflow-x: auto;">{"".join(parts)}</div>'


def _remark(remark: Remark) -> str:
    return f'<p style="margin: 4px 0; max-width: 60em; {KINDS[remark.kind]}">{html.escape(remark.text)}</p>'


def _table(table: Table) -> str:
    headings = [Cell(column.heading) for column in table.columns]
    rows = "".join(_row(row, "td", 15) for row in table.rows)
    return (
        f'<p style="margin: 12px 0 4px; font-weight: 600;">{html.escape(table.title)}</p>'
        f'<table style="{TABLE}">'
        f"<thead>{_row(headings, 'th', 60)}</thead><tbody>{rows}</tbody></table>"
        f'<p style="margin: 4px 0; {SMALL}">{html.escape(table.caption)}</p>'
    )


def _row(cells: Sequence[Cell], tag: str, share: int) -> str:
    written = []
    for i, cell in enumerate(cells):
        style = CELL.format(align="right" if i else "left") + ("" if i else " padding-left: 0;")
        small = f'<br><span style="{SMALL}">{html.escape(cell.small)}</span>' if cell.small else ""
        written.append(f'<{tag} style="{style}">{html.escape(cell.text)}{small}</{tag}>')
    return f'<tr style="background: none; {RULE.format(share=share)}">{"".join(written)}</tr>'
