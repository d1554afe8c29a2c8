"""The performance profile, and which part of it is worth most of the figure."""

from collections.abc import Mapping

import numpy as np
import plotly.graph_objects as go

from armctl.episodes.table import EpisodeTable
from armctl.report.style import SHARE_AXIS, Styles, add_band, add_line, framed
from armctl.stats.intervals import performance_profile

THRESHOLDS = 120
"""Most points of a line."""
TAIL = 0.05
"""Share of a policy's episodes that the figure may leave out at first."""


def profile(episodes: Mapping[str, EpisodeTable], styles: Styles) -> go.Figure:
    """Share of episodes with a return above each threshold, with 95 % intervals (Agarwal et al. 2021)."""
    returns = {name: results.column("total_reward") for name, results in episodes.items()}
    values = np.unique(np.concatenate(list(returns.values())))
    if len(values) > THRESHOLDS:
        values = np.unique(np.quantile(values, np.linspace(0, 1, THRESHOLDS)))
    thresholds = np.concatenate(([values[0] - 0.02 * (np.ptp(values) or 1.0)], values))
    figure = go.Figure()
    for name, sample in returns.items():
        shares = performance_profile(sample, thresholds)
        add_band(
            figure, thresholds, [share.low for share in shares], [share.high for share in shares], styles[name], "hv"
        )
        add_line(figure, thresholds, [share.value for share in shares], styles[name], "hv", "%{y:.0%} above %{x:.4~r}")
    return framed(figure, "return", "share of episodes above it", y=SHARE_AXIS)


def profile_start(episodes: Mapping[str, EpisodeTable]) -> float | None:
    """Return a start for a performance profile's axis, so that far lower returns do not squeeze it; None: nowhere.

    First the policy with the lowest median is left out, if that halves the axis at least, by itself or with the `TAIL`
    of the others; then all returns below a gap of two thirds of the rest, unless the best policy's median is there.
    """
    returns = [np.sort(results.column("total_reward")) for results in episodes.values()]
    returns.sort(key=lambda sample: float(np.median(sample)))
    lowest, highest = min(sample[0] for sample in returns), max(sample[-1] for sample in returns)
    start = lowest
    if len(returns) > 1:
        without = (
            min(float(np.quantile(sample, tail, method="lower")) for sample in returns[1:]) for tail in (0, TAIL)
        )
        start = next((begin for begin in without if highest - begin < (highest - lowest) / 2), start)
    rest = np.unique(np.concatenate([sample[sample >= start] for sample in returns]))
    if len(rest) > 1:
        widest = int(np.argmax(np.diff(rest)))
        if np.diff(rest)[widest] > 2 * np.ptp(rest) / 3 and rest[widest] < np.median(returns[-1]):
            start = rest[widest + 1]
    return float(start) if start > lowest and highest > start else None
