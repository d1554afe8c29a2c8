"""The figures of a suite: from numbers to `plotly.graph_objects.Figure`, without I/O."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from armctl.report.colours import COLOURS, FAMILY_COLOURS, PALE, PAPER
from armctl.report.style import (
    SHARE_AXIS,
    Style,
    Styles,
    add_band,
    add_interval,
    add_label,
    add_line,
    escaped,
    framed,
    with_rows,
)
from armctl.stats.intervals import Estimate

CLASSICAL, LEARNED = Style("best classical", COLOURS[0]), Style("best learned", COLOURS[1])
HYBRID = Style("best hybrid", COLOURS[2])
SYMBOLS = {
    "circle": "●", "square": "■", "diamond": "◆", "triangle-up": "▲", "triangle-down": "▼", "star": "★", "hexagon": "⬢",
}  # fmt: skip
"""Symbols of tasks in figures, and in a text."""
HALVES = (0.1, 0.2, 0.3, 0.4, 0.5)
"""Possible reaches of an axis to both sides of one half."""
MIN_MS, MIN_DECISIONS = 1e-3, 1e3
"""Starts of logarithmic axes, at which lower costs are shown."""


@dataclass(frozen=True)
class CostPoint:
    """A policy in a task."""

    policy: str
    task: str
    style: Style
    symbol: str
    success: float
    cost: float
    """Decision time, ms, or number of decisions in training."""


def intervals(rows: Mapping[str, Estimate], colours: Mapping[str, str]) -> go.Figure:
    """Return a row for each share between 0 and 1, with its 95 % interval; dotted: one half, in the middle."""
    figure = go.Figure()
    for name, estimate in rows.items():
        low, high = (estimate.value if bound is None else bound for bound in (estimate.low, estimate.high))
        hover_text = f"{estimate.value:.1%} [{low:.1%}, {high:.1%}]"
        add_interval(figure, name, low, estimate.value, high, colours[name], hover_text)
        add_label(figure, name, f"<b>{100 * estimate.value:.1f} %</b>", f"{100 * low:.1f} to {100 * high:.1f}")
    figure.add_vline(x=0.5, line={"color": PALE, "width": 1, "dash": "dot"})
    farthest = max((abs(end - 0.5) for trace in figure.data for end in trace.x), default=0.5)
    half = next(half for half in HALVES if half >= min(farthest, 0.5))
    ends = [0.5 - half, 0.5 + half]
    x = {"range": [ends[0] - 0.02, ends[1] + 0.02], "tickvals": ends, "tickformat": ".0%"}
    return with_rows(figure, len(rows), x, right=100)


def profiles(lines: Sequence[tuple[Style, Sequence[Estimate]]], thresholds: NDArray[np.float64]) -> go.Figure:
    """Share of cells with a success of at least each threshold."""
    figure = go.Figure()
    for style, shares in lines:
        add_band(figure, thresholds, [share.low for share in shares], [share.high for share in shares], style, "vh")
        add_line(figure, thresholds, [share.value for share in shares], style, "vh", "%{y:.0%} with %{x:.0%} or more")
    return framed(figure, "success of at least", "share of tasks and settings", x=SHARE_AXIS, y=SHARE_AXIS, height=320)


def cost_plane(points: Sequence[CostPoint], x_title: str, unit: str, min_cost: float) -> go.Figure:
    """Success against a cost, on a logarithmic axis from `min_cost` on. Colours are of families, symbols of tasks."""
    figure = go.Figure()
    costs = [max(point.cost, min_cost) for point in points]
    for point, cost in zip(points, costs, strict=True):
        name = f"{escaped(point.policy)} in {escaped(point.task)}"
        figure.add_scatter(
            x=[cost],
            y=[point.success],
            mode="markers",
            cliponaxis=False,
            marker={
                "symbol": point.symbol, "size": 12, "color": point.style.colour, "opacity": 0.85,
                "line": {"width": 1, "color": PAPER},
            },
            hovertemplate=f"{name}: %{{y:.1%}}, {point.cost:.3g} {escaped(unit)}<extra></extra>",
        )  # fmt: skip
    low, high = math.log10(min(costs, default=min_cost)), math.log10(max(costs, default=min_cost))
    x = {"type": "log", "dtick": 1, "tickformat": "~s" if min_cost >= 1 else "~g", "range": [low - 0.3, high + 0.3]}
    return framed(figure, x_title, "mean success", x=x, y=SHARE_AXIS, height=330)


def family_styles(families: Sequence[str]) -> Styles:
    """Return a style for each family; if there are too many, the last ones share the dark one."""
    last = len(FAMILY_COLOURS) - 1
    return {name: Style(name, FAMILY_COLOURS[min(i, last)]) for i, name in enumerate(families)}
