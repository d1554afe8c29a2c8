"""The figures of a comparison with their texts, as the report's page shows them."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
import plotly.graph_objects as go
from markupsafe import Markup

from armctl.report import cost_figures, figures, style
from armctl.report.colours import TERM_COLOURS
from armctl.report.profile import profile, profile_start
from armctl.rollout.decision_times import Machines
from armctl.stats.correction import AdjustedP, holm_adjusted
from armctl.stats.difference import Difference
from armctl.stats.intervals import Estimate
from armctl.stats.robustness import RobustnessRanking
from armctl.study.comparison import Comparison
from armctl.study.curves import training_curves
from armctl.verdict.summary import PolicySummary
from armctl.verdict.summary_tables import tests_in_words
from armctl.verdict.tables import p_value
from armctl.verdict.trade_off import break_evens, cost_curve, pareto_front, points

NOTHING = "\u2013"
MAX_PAIRS = 6
"""If there are more pairs of policies than this, only those with the best policy are shown."""


@dataclass(frozen=True)
class Plot:
    """A figure with its texts."""

    figure: go.Figure
    alt_text: str
    title: str = ""
    note: str = ""
    whole_axis: Sequence[float] = ()
    """The range of the x axis that shows everything, if the figure shows only a part of it at first."""

    @property
    def json(self) -> Markup:
        """The figure as JSON for Plotly's JavaScript, escaped so that it can stand in a script element."""
        text = str(self.figure.to_json())
        return Markup(text.replace("<", r"\u003c").replace(">", r"\u003e").replace("&", r"\u0026"))


def comparison_plots(comparison: Comparison, styles: style.Styles) -> dict[str, Any]:
    """All figures of a comparison with at least one episode, by their names on the page."""
    policies, episodes, unknown = comparison.policies, comparison.counted, comparison.facts.unknown
    terms = figures.term_means(episodes)
    term_styles = {
        term: style.Style(term, TERM_COLOURS[i % len(TERM_COLOURS)])
        for i, term in enumerate(dict.fromkeys(itertools.chain(*terms.values())))
    }
    curves, problems = training_curves([policy.policy for policy in policies], comparison.env, comparison.env_options)
    period = None if any(policy.timing for policy in policies) else comparison.facts.control_period
    by_success = any(policy.success for policy in policies)
    machines = Machines.of(comparison.runs, comparison.results)
    return {
        "by_success": by_success,
        "tests": tests_in_words(comparison.differences),
        "shown": [styles[name] for name in episodes],
        "success": Plot(
            figures.success_bars(policies, styles),
            "; ".join(f"{policy.policy}: success {percent(policy.success)}" for policy in policies),
        )
        if by_success
        else Plot(
            figures.return_points(policies, styles),
            "; ".join(f"{policy.policy}: return {mean(policy.episode_return)}" for policy in policies),
        ),
        "profile": None if "return" in unknown else _profile(comparison, styles),
        "paired": [] if "return" in unknown else _paired(comparison, styles),
        "reward_terms": Plot(
            figures.reward_terms(terms, styles, term_styles),
            "; ".join(
                f"{name}: " + ", ".join(f"{term} {value:.4g}" for term, value in rewards.items())
                for name, rewards in terms.items()
            ),
        )
        if term_styles
        else None,
        "term_styles": term_styles,
        "decision_times": Plot(
            figures.decision_times(episodes, styles, None if period is None else 1e3 * period, machines),
            "; ".join(
                f"{policy.policy}: median {policy.decision_ms_p50:.3g} ms, "
                f"99th percentile {policy.decision_ms_p99:.3g} ms"
                for policy in policies
            ),
            note=_besides_decisions(policies),
        )
        if not comparison.facts.sources
        else None,
        "trade_off": trade_off_plot(policies, styles),
        "training_cost": _training_cost(policies, curves, styles),
        "curve_problems": problems,
    }


def trade_off_plot(policies: Sequence[PolicySummary], styles: style.Styles) -> Plot | None:
    """Success or return against decision time; None if the times cannot be compared, or there is one policy."""
    policy_points = points(policies)
    if len(policy_points) < 2:
        return None
    front = ", ".join(styles[point.label].label for point in pareto_front(policy_points))
    by_success = any(policy.success for policy in policies)
    times = f" Times are {policies[0].timing}." if policies[0].timing else ""
    dots = (
        "Dots: decision time per control step, reset included, median over episodes; lines: up to the 99th percentile."
    )
    return Plot(
        cost_figures.trade_off(policy_points, styles, by_success),
        f"{'Success' if by_success else 'Return'} against decision time",
        note=f"{dots} Pareto front: {front}.{times}",
    )


def _training_cost(
    policies: Sequence[PolicySummary], curves: Mapping[str, pd.DataFrame], styles: style.Styles
) -> Plot | None:
    """Success against decisions of training, and the break-even points in words; None if no decisions are known."""
    costs = {
        policy.policy: cost_curve(policy, curves.get(policy.policy))
        for policy in policies
        if policy.side != "classical"
    }
    known_costs = {name: curve for name, curve in costs.items() if not curve.empty}
    if not known_costs:
        return None
    break_even_points = break_evens(policies, curves)
    sentences = [str(break_even) for break_even in break_even_points]
    if unknown := [name for name in costs if name not in known_costs]:
        sentences.append(f"How many decisions it took to train {', '.join(unknown)} is unknown.")
    figure = cost_figures.training_cost(known_costs, policies, break_even_points, styles)
    return Plot(figure, "Success against decisions of training", note=renamed(" ".join(sentences), styles))


def renamed(text: str, styles: style.Styles) -> str:
    """Return a text with the labels of policies in place of their names."""
    for name in sorted(styles, key=len, reverse=True):
        text = text.replace(name, styles[name].label)
    return text


def sweep_plots(sweep: pd.DataFrame, rankings: Sequence[RobustnessRanking], styles: style.Styles) -> list[Plot]:
    """Return a figure for each disturbance of a sweep, and its robustness ranking."""
    label = "Success" if sweep.success.notna().any() else "Return"
    notes = {ranking.disturbance: renamed(str(ranking), styles) for ranking in rankings}
    return [
        Plot(
            figures.robustness(rows, styles),
            f"{label} against the level of {name}",
            str(name),
            notes.get(str(name), ""),
        )
        for name, rows in sweep.groupby("disturbance", sort=False)
        if rows.level.nunique() > 1
    ]


def _profile(comparison: Comparison, styles: style.Styles) -> Plot:
    figure, alt_text = profile(comparison.counted, styles), "Share of episodes above each return, by policy"
    start = profile_start(comparison.counted)
    if start is None:
        return Plot(figure, alt_text)
    returns = {name: table.column("total_reward") for name, table in comparison.counted.items()}
    lowest = float(min(sample.min() for sample in returns.values()))
    highest = float(max(sample.max() for sample in returns.values()))
    visible_range, whole = ([low - 0.02 * (highest - low), highest + 0.02 * (highest - low)] for low in (start, lowest))
    figure.update_xaxes(range=visible_range)
    beneath = [name for name, sample in returns.items() if sample.max() < start]
    left_out = sum(int((sample < start).sum()) for sample in returns.values())
    note = f"The axis begins at {style.number(start)}: {left_out} episodes with lower returns are left out"
    if beneath:
        note += f", among them all of {', '.join(styles[name].label for name in beneath)}"
    return Plot(figure, alt_text, note=f"{note}.", whole_axis=whole)


def _paired(comparison: Comparison, styles: style.Styles) -> list[Plot]:
    pairs = list(
        zip(comparison.differences, holm_adjusted(comparison.differences, comparison.facts.baseline), strict=True)
    )
    if len(pairs) > MAX_PAIRS:
        reached = [policy for policy in comparison.policies if not policy.spared]
        best = max(reached, key=lambda policy: _score(policy.success or policy.episode_return))
        pairs = [(pair, p) for pair, p in pairs if best.policy in (pair.a, pair.b)]
    return [
        Plot(
            figures.paired(pair, comparison.counted, styles),
            f"{'Returns' if pair.paired else 'Quantiles of returns'} of {pair.a} against those of {pair.b}",
            f"{styles[pair.a].label} against {styles[pair.b].label}",
            _difference(pair, p),
        )
        for pair, p in pairs
    ]


def _besides_decisions(policies: Sequence[PolicySummary]) -> str:
    """Describe what policies compute besides their decisions."""
    times = {
        "Reset before an episode's first decision (median)": {policy.policy: policy.reset_ms for policy in policies},
        "Construction": {policy.policy: policy.construction_ms for policy in policies},
    }
    sentences = (
        f"{label}: "
        + ", ".join(f"{name} {spent:.3g} ms" for name, spent in times_by_policy.items() if spent is not None)
        + "."
        for label, times_by_policy in times.items()
        if any(spent is not None for spent in times_by_policy.values())
    )
    return " ".join(sentences)


def _difference(pair: Difference, p: AdjustedP) -> str:
    """Describe a pair's figure in numbers."""
    gain = pair.return_difference
    earns = "Return unknown." if math.isnan(gain.value) else f"Return {gain.value:+.1f} ({spread(gain, sign='+')})."
    if pair.success_p is None:
        chance = 100 * pair.superiority.probability.value
        interval = spread(pair.superiority.probability, 100)
        share, test = f"in {chance:.1f} % of the episodes", "sign test "
        if not pair.paired:
            share, test = f"with a probability of {chance:.1f} %", ""
        return style.signed(
            f"{earns} The first has the higher return {share} ({interval} %; a tie counts half), "
            f"{test}p = {p_value(p.higher)} after Holm's correction."
        )
    success = pair.success_difference
    counts = f"{pair.only_a} won only by the first, {pair.only_b} only by the second"
    if not pair.paired:
        first, second = (f"{won} of {size}" for won, size in zip(pair.wins, pair.sample_sizes, strict=True))
        counts = f"{first} won by the first, {second} by the second"
    return (
        f"Success {100 * (success.value if success else 0):+.1f} % ({spread(success, 100, '+')}): {counts}, "
        f"p = {p_value(p.success)} after Holm's correction. " + style.signed(earns)
    )


def _score(estimate: Estimate | None) -> float:
    return estimate.value if estimate else 0.0


def percent(estimate: Estimate | None) -> str:
    """Return a share in percent."""
    return NOTHING if estimate is None else f"{100 * estimate.value:.1f} %"


def mean(estimate: Estimate | None) -> str:
    """Return a value."""
    return NOTHING if estimate is None else style.signed(f"{estimate.value:,.1f}")


def spread(estimate: Estimate | None, scale: float = 1.0, sign: str = "") -> str:
    """Return an interval."""
    if estimate is None or estimate.low is None or estimate.high is None:
        return "interval unknown" if estimate else ""
    low, high = scale * estimate.low, scale * estimate.high
    return style.signed(f"{low:{sign}.1f} to {high:{sign}.1f}")
