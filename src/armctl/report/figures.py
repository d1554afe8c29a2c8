"""The report's figures, by Plotly: from numbers to `plotly.graph_objects.Figure`, without I/O.

A policy looks the same in all figures. Further policies have the same colours with other dashes.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from armctl.episodes.table import EpisodeTable
from armctl.report.colours import ALARM, INK, PALE, PAPER
from armctl.report.style import (
    CELLS,
    MAX_DOTS,
    SHARE_AXIS,
    Styles,
    add_band,
    add_interval,
    add_label,
    add_line,
    add_spared_line,
    escaped,
    framed,
    number,
    signed,
    with_rows,
)
from armctl.rollout.decision_times import Machines, comparable_times
from armctl.stats.difference import Difference
from armctl.verdict.summary import PolicySummary
from armctl.verdict.trade_off import SHORTEST_MS


def success_bars(policies: Sequence[PolicySummary], styles: Styles) -> go.Figure:
    """Success of each policy, with its 95 % interval."""
    figure = go.Figure()
    for policy in policies:
        if (success := policy.success) is None or success.low is None or success.high is None:
            continue
        value, low, high = 100 * success.value, 100 * success.low, 100 * success.high
        style = styles[policy.policy]
        figure.add_bar(
            x=[value],
            y=[escaped(style.label)],
            orientation="h",
            width=0.56,
            marker={"color": style.colour, "pattern": {"shape": "" if style.dash == "solid" else "/"}},
            error_x={
                "type": "data", "symmetric": False, "array": [high - value], "arrayminus": [value - low],
                "color": INK, "thickness": 1.6, "width": 5,
            },
            hovertemplate=f"{escaped(style.label)}: {value:.1f} % [{low:.1f}, {high:.1f}] of {policy.episodes}"
            "<extra></extra>",
        )  # fmt: skip
        small = f"spared {', '.join(policy.spared)}" if policy.spared else f"{low:.1f} to {high:.1f}"
        add_label(figure, style.label, f"<b>{value:.1f} %</b>", small)
    return with_rows(figure, len(policies), {"range": [0, 101], "ticksuffix": " %", "dtick": 50}, right=100)


def return_points(policies: Sequence[PolicySummary], styles: Styles) -> go.Figure:
    """Mean return of each policy, with its 95 % interval if it is known, where success is unknown."""
    figure = go.Figure()
    for policy in policies:
        if (mean_return := policy.episode_return) is None:
            continue
        style = styles[policy.policy]
        low, high = (mean_return.value if bound is None else bound for bound in (mean_return.low, mean_return.high))
        is_bounded = mean_return.low is not None
        text = f"{mean_return.value:.4g}" + (f" [{low:.4g}, {high:.4g}]" if is_bounded else ", interval unknown")
        add_interval(figure, style.label, low, mean_return.value, high, style.colour, text)
        bounds = f"{number(low)} to {number(high)}" if is_bounded else ""
        add_label(figure, style.label, f"<b>{number(mean_return.value)}</b>", bounds)
    ends = [float(end) for trace in figure.data for end in trace.x]
    margin = 0.05 * (max(ends) - min(ends) or 1.0)
    x = {"title": {"text": "mean return of an episode"}, "range": [min(ends) - margin, max(ends) + margin]}
    return with_rows(figure, len(policies), x, right=130)


def paired(pair: Difference, episodes: Mapping[str, EpisodeTable], styles: Styles) -> go.Figure:
    """Scatter plot of two policies' returns, episode by episode. A dot's size shows how many episodes coincide.

    Without pairs, it is of their quantiles.
    """
    a, b = styles[pair.a], styles[pair.b]
    tables = [episodes[pair.a], episodes[pair.b]]
    if pair.paired:
        returns = [
            pd.DataFrame({"episode": table.column("episode"), name: table.column("total_reward")})
            for name, table in zip("ab", tables, strict=True)
        ]
        points = returns[0].merge(returns[1], on="episode")
        coinciding = "%{customdata[0]} episodes, the first: %{customdata[1]}"
    else:
        shares = (np.arange(pair.episodes) + 0.5) / pair.episodes
        points = pd.DataFrame(
            {name: np.quantile(table.column("total_reward"), shares) for name, table in zip("ab", tables, strict=True)}
        ).assign(episode=np.round(100 * shares, 1))
        coinciding = "%{customdata[0]} quantiles, the first: %{customdata[1]} %"
    lowest, highest = float(points[["a", "b"]].min().min()), float(points[["a", "b"]].max().max())
    if len(points) > MAX_DOTS and highest > lowest:
        cell = (highest - lowest) / CELLS
        points[["a", "b"]] = (points[["a", "b"]] / cell).round() * cell
    dots = points.groupby(["a", "b"]).episode.agg(["size", "first"]).reset_index()
    colours = np.select([dots.a > dots.b, dots.a < dots.b], [a.colour, b.colour], PALE)
    edge = 0.06 * (highest - lowest or 1.0)
    span = [lowest - edge, highest + edge]
    figure = go.Figure()
    figure.add_scatter(x=span, y=span, mode="lines", line={"color": PALE, "width": 1, "dash": "dot"}, hoverinfo="skip")
    figure.add_scatter(
        x=dots.b.tolist(),
        y=dots.a.tolist(),
        mode="markers",
        marker={
            "color": colours.tolist(),
            "size": np.clip(5 + 2.5 * np.sqrt(dots["size"]), 0, 26).tolist(),
            "opacity": 0.6,
            "line": {"width": 0},
        },
        customdata=dots[["size", "first"]].to_numpy().tolist(),
        hovertemplate=f"{escaped(a.label)} %{{y:.4~r}}, {escaped(b.label)} %{{x:.4~r}}<br>{coinciding}<extra></extra>",
    )
    axis = {"range": span, "nticks": 5}
    return framed(figure, f"return of {escaped(b.label)}", f"return of {escaped(a.label)}", x=axis, y=axis, height=300)


def robustness(sweep: pd.DataFrame, styles: Styles) -> go.Figure:
    """Success, or return if success is unknown, against the levels of one disturbance, with known 95 % intervals."""
    figure = go.Figure()
    by_success = bool(sweep.success.notna().any())
    for name, rows in sweep.groupby("policy", sort=False):
        levels = [f"{level:g}" for level in rows.level]
        if "spared" in rows and rows.spared.any():
            add_spared_line(figure, levels, rows["success" if by_success else "return"], styles[str(name)])
        elif by_success:
            add_band(figure, levels, rows.low, rows.high, styles[str(name)])
            add_line(figure, levels, rows.success, styles[str(name)], "linear", "%{y:.1%} at %{x}", markers=True)
        else:
            add_band(figure, levels, rows["return_low"], rows["return_high"], styles[str(name)])
            add_line(figure, levels, rows["return"], styles[str(name)], "linear", "%{y:.4~r} at %{x}", markers=True)
    unit = f"level, {sweep.unit.iloc[0]}" if "unit" in sweep and isinstance(sweep.unit.iloc[0], str) else "level"
    y_title, y = ("success", SHARE_AXIS) if by_success else ("return", None)
    return framed(figure, unit, y_title, x={"type": "category"}, y=y, height=300)


def reward_terms(terms: Mapping[str, Mapping[str, float]], styles: Styles, term_styles: Styles) -> go.Figure:
    """Mean of each reward term per episode, for each policy. The diamond is their sum, the mean return."""
    labels = [escaped(styles[name].label) for name in terms]
    figure = go.Figure()
    for term, style in term_styles.items():
        figure.add_bar(
            x=[term_rewards.get(term, 0.0) for term_rewards in terms.values()],
            y=labels,
            orientation="h",
            width=0.56,
            marker={"color": style.colour},
            hovertemplate=f"{escaped(style.label)}: %{{x:.4~r}}<extra></extra>",
        )
    totals = {name: sum(term_rewards.values()) for name, term_rewards in terms.items()}
    figure.add_scatter(
        x=list(totals.values()),
        y=labels,
        mode="markers",
        marker={"symbol": "diamond", "size": 10, "color": INK, "line": {"color": PAPER, "width": 1.5}},
        hovertemplate="return %{x:.4~r}<extra></extra>",
    )
    for name, total in totals.items():
        add_label(figure, styles[name].label, f"<b>{signed(f'{total:,.1f}')}</b>")
    figure.update_layout(barmode="relative")
    x = {"title": {"text": "mean reward per episode"}, "zeroline": True, "zerolinecolor": INK, "zerolinewidth": 1}
    return with_rows(figure, len(terms), x, right=80)


def decision_times(
    episodes: Mapping[str, EpisodeTable], styles: Styles, deadline_ms: float | None, machines: Machines
) -> go.Figure:
    """Decision times: median, middle half, 1st to 99th percentile and maximum, on a logarithmic axis."""
    figure = go.Figure()
    for name, results in episodes.items():
        times = comparable_times(results, machines).warm_times()
        shares = (0.01, 0.25, 0.5, 0.75, 0.99, 1.0)
        q1, p25, p50, p75, p99, longest = times.quantiles(shares, at_least=SHORTEST_MS)
        style, label = styles[name], escaped(styles[name].label)
        for ends, width, opacity in (((q1, longest), 2, 0.5), ((q1, p99), 6, 0.55), ((p25, p75), 14, 1.0)):
            figure.add_scatter(
                x=list(ends), y=[label] * 2, mode="lines", line={"color": style.colour, "width": width},
                opacity=opacity, hoverinfo="skip",
            )  # fmt: skip
        figure.add_scatter(
            x=[p50, p99, longest],
            y=[label] * 3,
            mode="markers",
            marker={
                "symbol": ["line-ns", "line-ns", "circle"], "size": [20, 14, 7], "color": style.colour,
                "line": {"width": [3, 2, 0], "color": [INK, style.colour, style.colour]},
            },
            customdata=["median", "99th percentile", "maximum"],
            hovertemplate=f"{label}, %{{customdata}}: %{{x:.3~r}} ms<extra></extra>",
        )  # fmt: skip
        add_label(figure, styles[name].label, f"<b>{number(p50, 2)}</b>", f"{number(p99, 2)}, {number(longest, 2)}")
    edges = [edge for trace in figure.data for edge in trace.x]
    if deadline_ms is not None:
        edges.append(deadline_ms)
        figure.add_vline(x=deadline_ms, line={"color": ALARM, "width": 1.5, "dash": "dash"})
        figure.add_annotation(
            x=math.log10(deadline_ms), y=1, yref="paper", yanchor="bottom", xanchor="right", showarrow=False,
            text=f"deadline {deadline_ms:g} ms", font={"color": ALARM, "size": 12},
        )  # fmt: skip
    x = {
        "type": "log", "title": {"text": "decision time, ms"}, "dtick": 1, "tickformat": "~g",
        "range": [math.log10(min(edges)) - 0.1, math.log10(max(edges)) + 0.1],
    }  # fmt: skip
    return with_rows(figure, len(episodes), x, right=90, top=26)


def term_means(episodes: Mapping[str, EpisodeTable]) -> dict[str, dict[str, float]]:
    """Mean of each reward term over each policy's episodes."""
    return {
        name: {term: math.fsum(rewards) / len(results) for term, rewards in results.reward_sums().items()}
        for name, results in episodes.items()
    }
