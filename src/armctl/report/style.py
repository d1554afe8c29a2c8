"""The style of figures: styles of policies, axes, labels, bands."""

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from armctl.report.colours import COLOURS, GRID, INK, LINE, PALE, PAPER, faint

DASHES = ("solid", "dash", "dot", "dashdot")
SYMBOLS = dict(zip(DASHES, ("circle", "square", "diamond", "cross"), strict=True))
FONT = "'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
LONGEST_LABEL = 20
MAX_DOTS, CELLS = 1000, 80
"""Limit of a scatter plot's dots: with more episodes, all in one cell of a `CELLS` x `CELLS` grid are one dot."""
ROW = 44
"""Height of a policy's row, pixels."""


@dataclass(frozen=True)
class Style:
    """Label, colour and dash of a policy or a reward term."""

    label: str
    colour: str
    dash: str = "solid"


Styles = Mapping[str, Style]


def styles_of(names: Sequence[str]) -> dict[str, Style]:
    """Return a style for each policy. The label of an agent's file is shortened if the labels stay distinct."""
    short = {name: shortened(name) for name in names}
    labels = short if len(set(short.values())) == len(names) else {name: name for name in names}
    return {
        name: Style(labels[name], COLOURS[i % len(COLOURS)], DASHES[i // len(COLOURS) % len(DASHES)])
        for i, name in enumerate(names)
    }


def number(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, but all digits before the decimal point; a dash for NaN."""
    if math.isnan(value):
        return "\u2013"
    return signed(f"{value:,.0f}" if abs(value) >= 10**digits - 0.5 else f"{value:.{digits}g}")


def signed(number: str) -> str:
    """Return a number's text with a minus sign in place of a hyphen."""
    return number.replace("-", "\u2212")


SHARE_AXIS = {
    "range": [-0.02, 1.02],
    "tickvals": [0, 0.25, 0.5, 0.75, 1],
    "ticktext": ["0 %", "25 %", "50 %", "75 %", "100 %"],
}
AXIS = {
    "gridcolor": GRID, "zeroline": False, "linecolor": LINE, "ticks": "", "automargin": True, "fixedrange": True,
    "title": {"standoff": 8, "font": {"size": 13, "color": PALE}},
}  # fmt: skip


def framed(
    figure: go.Figure,
    x_title: str,
    y_title: str,
    x: Mapping[str, Any] | None = None,
    y: Mapping[str, Any] | None = None,
    height: int = 360,
) -> go.Figure:
    """Give a figure its style and axes."""
    dress(figure, height, {"l": 8, "r": 12, "t": 10, "b": 8})
    figure.update_xaxes(title_text=x_title, showline=True, **(x or {}))
    figure.update_yaxes(title_text=y_title, **(y or {}))
    return figure


def with_rows(figure: go.Figure, rows: int, x: Mapping[str, Any], right: int, top: int = 6) -> go.Figure:
    """Give a figure its style, and one row for each policy, the first on top."""
    dress(figure, ROW * rows + 64 + top, {"l": 8, "r": right, "t": top, "b": 8})
    figure.update_xaxes(tickangle=0, **x)
    figure.update_yaxes(autorange="reversed", showgrid=False, ticks="outside", tickcolor=PAPER, type="category")
    return figure


def dress(figure: go.Figure, height: int, margin: Mapping[str, int]) -> None:
    """Give a figure the common style."""
    figure.update_layout(
        template="none",
        height=height,
        margin=margin,
        font={"family": FONT, "size": 13, "color": INK},
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        showlegend=False,
        hovermode="closest",
        dragmode=False,
        hoverlabel={"bgcolor": PAPER, "bordercolor": GRID, "font": {"family": FONT, "size": 13, "color": INK}},
    )
    figure.update_xaxes(**AXIS)
    figure.update_yaxes(**AXIS)


def add_label(figure: go.Figure, label: str, text: str, small: str = "") -> None:
    """Add text to the right of a policy's row."""
    if small:
        text += f'<br><span style="font-size: 11.5px; color: {PALE}">{small}</span>'
    figure.add_annotation(
        x=1, xref="paper", xanchor="left", xshift=12, y=escaped(label), text=text, showarrow=False, align="left"
    )


def add_interval(
    figure: go.Figure, label: str, low: float, value: float, high: float, colour: str, hover_text: str
) -> None:
    """Add a dot on a thick line to the row of a label. `hover_text` is the text at the dot."""
    row = escaped(label)
    figure.add_scatter(
        x=[low, high], y=[row] * 2, mode="lines", line={"color": colour, "width": 6}, opacity=0.4, hoverinfo="skip"
    )
    figure.add_scatter(
        x=[value],
        y=[row],
        mode="markers",
        marker={"color": colour, "size": 12},
        hovertemplate=f"{row}: {hover_text}<extra></extra>",
    )


def add_line(
    figure: go.Figure,
    x: Any,
    y: Any,
    style: Style,
    shape: str,
    hover: str,
    markers: bool = False,
) -> None:
    """Add a policy's line. `hover` is the text at a point, in Plotly's template language."""
    figure.add_scatter(
        x=listed(x),
        y=listed(y),
        name=escaped(style.label),
        mode="lines+markers" if markers or len(listed(x)) == 1 else "lines",
        marker={"size": 6},
        line={"color": style.colour, "width": 2.5, "dash": style.dash, "shape": shape},
        hovertemplate=f"{escaped(style.label)}: {hover}<extra></extra>",
    )


def add_spared_line(figure: go.Figure, x: Any, y: Any, style: Style) -> None:
    """Add the line of a policy that the disturbance does not reach: dotted and thin, with hollow points."""
    figure.add_scatter(
        x=listed(x),
        y=listed(y),
        name=f"{escaped(style.label)} (spared)",
        mode="lines+markers",
        marker={"size": 8, "symbol": "circle-open"},
        line={"color": style.colour, "width": 1.5, "dash": "dot"},
        hovertemplate=f"{escaped(style.label)}: spared<extra></extra>",
    )


def add_point(figure: go.Figure, x: Any, y: Any, low: Any, high: Any, style: Style, hover: str) -> None:
    """Add a policy's points with vertical intervals. `hover` is the text at one, in Plotly's template language."""
    y, low, high = (np.asarray(values, dtype=float) for values in (y, low, high))
    figure.add_scatter(
        x=listed(x),
        y=listed(y),
        name=escaped(style.label),
        mode="markers",
        marker={"color": style.colour, "size": 11, "symbol": SYMBOLS[style.dash], "line": {"color": PAPER, "width": 1}},
        error_y={
            "type": "data", "symmetric": False, "array": listed(high - y), "arrayminus": listed(y - low),
            "color": style.colour, "thickness": 1.6, "width": 4,
        },
        hovertemplate=f"{escaped(style.label)}: {hover}<extra></extra>",
    )  # fmt: skip


def add_band(figure: go.Figure, x: Any, low: Any, high: Any, style: Style, shape: str = "linear") -> None:
    """Add a band between `low` and `high`; it has gaps where either is unknown."""
    x, low, high = listed(x), listed(low), listed(high)
    edge = {"width": 0, "shape": shape}
    figure.add_scatter(x=x, y=low, mode="lines", line=edge, hoverinfo="skip")
    figure.add_scatter(
        x=x, y=high, mode="lines", line=edge, hoverinfo="skip", fill="tonexty", fillcolor=faint(style.colour)
    )


def listed(values: Any) -> list[Any]:
    """Values as a list: Plotly writes arrays in base64, which is unreadable in the file."""
    array: NDArray[Any] = np.asarray(values)
    return list(array.tolist())


def shortened(name: str) -> str:
    """Return a short label: an agent's file is called by its name, or by its folder's if it is called `agent`."""
    path = Path(name)
    if path.suffix in (".json", ".onnx"):
        name = path.parent.name if path.stem == "agent" and path.parent.name else path.stem
    return name if len(name) <= LONGEST_LABEL else "…" + name[1 - LONGEST_LABEL :]


def escaped(text: str) -> str:
    """Text escaped for Plotly, which interprets some HTML."""
    return html.escape(text, quote=False)
