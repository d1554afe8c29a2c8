"""The figures of what success costs: from numbers to `plotly.graph_objects.Figure`, without I/O."""

import math
from collections.abc import Mapping, Sequence

import pandas as pd
import plotly.graph_objects as go

from armctl.report.colours import PALE
from armctl.report.style import SHARE_AXIS, Style, Styles, add_band, add_line, add_point, framed
from armctl.verdict.summary import PolicySummary
from armctl.verdict.trade_off import BreakEven, Point, pareto_front

MARGIN = {"range": [-0.05, 1.05]}
"""Room for dots at 0 and 100 %."""
MAX_DECADES = 1.5
"""Width of a logarithmic axis on which labels at 1, 2 and 5 do not overlap on a phone."""


def training_cost(
    curves: Mapping[str, pd.DataFrame],
    policies: Sequence[PolicySummary],
    break_evens: Sequence[BreakEven],
    styles: Styles,
) -> go.Figure:
    """Success against decisions of training, with 95 % intervals: a line for each agent's curve, or a point.

    `curves` are those of `armctl.verdict.trade_off.cost_curve`. Dotted: policies that were not trained. Rings: where
    an agent breaks even with the best of these.
    """
    figure = go.Figure()
    ends = [end for curve in curves.values() for end in (curve.decisions.min(), curve.decisions.max())]
    span = [float(min(ends)) / 1.3, float(max(ends)) * 1.3]
    for policy in policies:
        style = styles[policy.policy]
        if (curve := curves.get(policy.policy)) is not None and not curve.empty:
            hover = "%{y:.1%} after %{x:,} decisions"
            if len(curve) == 1:
                add_point(figure, curve.decisions, curve.success, curve.low, curve.high, style, hover)
            else:
                add_band(figure, curve.decisions, curve.low, curve.high, style)
                add_line(figure, curve.decisions, curve.success, style, "linear", hover, markers=True)
        elif policy.success and policy.side == "classical":
            level = Style(style.label, style.colour, "dot")
            add_line(figure, span, [policy.success.value] * 2, level, "linear", "%{y:.1%}, without training")
    for point in break_evens:
        if point.decisions is not None:
            colour = styles[point.agent].colour
            figure.add_scatter(
                x=[point.decisions], y=[point.success.value], mode="markers", hoverinfo="skip",
                marker={"symbol": "circle-open", "size": 20, "line": {"width": 2.5}, "color": colour},
            )  # fmt: skip
    low, high = (math.log10(end) for end in span)
    x = {"type": "log", "range": [low, high], "tickformat": "~s", "dtick": 1 if high - low > MAX_DECADES else "D2"}
    return framed(figure, "decisions in simulation, for training", "success", x=x, y=SHARE_AXIS | MARGIN)


def trade_off(points: Sequence[Point], styles: Styles, by_success: bool = True) -> go.Figure:
    """Success, or return, against decision time: a dot at the median for each policy, a line to the 99th percentile.

    Vertical: 95 % intervals. The stairs are the Pareto front: whatever lies on or above them, no policy here does.
    """
    figure = go.Figure()
    slowest = max(max(point.slow_ms, point.decision_ms) for point in points)
    fastest = min(point.decision_ms for point in points)
    span = [math.log10(fastest) - 0.35, min(math.log10(slowest) + 0.35, 300.0)]
    front = pareto_front(points)
    figure.add_scatter(
        x=[*(point.decision_ms for point in front), 10 ** span[1]],
        y=[*(point.score.value for point in front), front[-1].score.value],
        mode="lines", line={"shape": "hv", "color": PALE, "width": 1.5, "dash": "dash"}, hoverinfo="skip",
    )  # fmt: skip
    value_format = "%{y:.1%}" if by_success else "%{y:.4~r}"
    for point in points:
        style = styles[point.label]
        figure.add_scatter(
            x=[point.decision_ms, point.slow_ms], y=[point.score.value] * 2, mode="lines", hoverinfo="skip",
            line={"color": style.colour, "width": 2}, opacity=0.5,
        )  # fmt: skip
        low, high = (point.score.value if end is None else end for end in (point.score.low, point.score.high))
        hover = f"{value_format}, %{{x:.3~r}} ms a decision"
        add_point(figure, [point.decision_ms], [point.score.value], [low], [high], style, hover)
    y = SHARE_AXIS | MARGIN if by_success else {"nticks": 6}
    x = {"type": "log", "range": span, "dtick": 1, "tickformat": "~g"}
    return framed(figure, "time of a control step, ms", "success" if by_success else "return", x=x, y=y, height=300)
