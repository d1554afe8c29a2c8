"""Comparisons and sweeps as tables for the terminal."""

from rich.box import SIMPLE_HEAD
from rich.console import Group
from rich.table import Table
from rich.text import Text

from armctl.evaluation.comparison import Comparison
from armctl.evaluation.degradation import FALSE_DISCOVERY_RATE, Degradation, degradations
from armctl.evaluation.statistics import Estimate, PairedDifference
from armctl.evaluation.summary import PolicySummary
from armctl.evaluation.sweep import Sweep
from armctl.evaluation.verdict import verdict


def tables(comparison: Comparison) -> Group:
    """The tables of a comparison, and its verdict."""
    parts: list[Table | Text] = [_policy_table(comparison)] if comparison.policies else []
    for policy in comparison.policies:
        ends = ", ".join(f"{count} {outcome}" for outcome, count in policy.outcomes.items())
        parts.append(Text("; ".join([f"{policy.policy}: {ends}", *_details(policy)])))
    if comparison.paired:
        parts += [
            Text(),
            _paired_table(comparison.paired),
            Text(),
            Text(verdict(comparison.policies, comparison.paired), style="bold"),
        ]
    if comparison.policies and (infeasible := comparison.policies[0].infeasible):
        parts.append(Text(f"{infeasible} episodes have a target out of reach; they are left out of all figures."))
    parts += [Text(message, style="red") for message in comparison.failures.values()]
    if comparison.resumed:
        parts.append(Text(f"{comparison.resumed} episodes were finished by an earlier run."))
    if comparison.interrupted:
        parts.append(Text("Interrupted.", style="yellow"))
    for policy in comparison.policies:
        if policy.episodes < policy.planned - policy.infeasible:
            counts = f"the first {policy.episodes} of {policy.planned} episodes"
            parts.append(Text(f"{policy.policy} was cut short: its figures are over {counts}.", style="yellow"))
    return Group(*parts)


def sweep_tables(sweep: Sweep) -> Group:
    """The tables of a sweep: success at each level, and from which level each policy gets worse."""
    parts: list[Table | Text] = []
    found = degradations(sweep.points)
    for name, rows in sweep.points.groupby("disturbance", sort=False):
        levels = [level for level in sweep.levels[str(name)] if level in set(rows.level)]
        if len(levels) == 1:  # the undisturbed one: cut short
            continue
        table = _table(f"{name}, {rows.unit.iloc[0]}", "", ["success, %", *(f"{level:g}" for level in levels)])
        for policy, its in rows.groupby("policy", sort=False):
            success = its.set_index("level").success
            table.add_row(str(policy), *(f"{100 * success[x]:.1f}" if x in success else "-" for x in levels))
        parts += [table, Text(_degradation_text([one for one in found if one.disturbance == name])), Text()]
    rate = f"false discovery rate {100 * FALSE_DISCOVERY_RATE:g} %"
    parts.append(Text(f"Worse: than without disturbance, on the same episodes (McNemar's exact test, {rate})."))
    parts += [Text(f"{what}: {why}", style="red") for what, why in sweep.failures.items()]
    if sweep.interrupted:
        parts.append(Text("Interrupted.", style="yellow"))
    return Group(*parts)


def _degradation_text(found: list[Degradation]) -> str:
    """The effect of one disturbance: a sentence for each policy that gets significantly worse."""
    sentences, unharmed = [], []
    for one in found:
        name = f"{one.policy} (sees the state)" if one.sees == "state" else one.policy
        steps = [] if one.drops is None else [f"worse from {one.drops:g} on"]
        steps += [] if one.below_half is None else [f"below half from {one.below_half:g} on"]
        if steps:
            sentences.append(f"{name}: {', '.join(steps)}.")
        else:
            unharmed.append(name)
    if unharmed:
        sentences.append(f"Not significantly worse: {', '.join(unharmed)}.")
    return " ".join(sentences)


def _details(policy: PolicySummary) -> list[str]:
    details = []
    if gap := policy.optimality_gap:
        spread = "" if gap.low is None or gap.high is None else f" [{100 * gap.low:.0f}, {100 * gap.high:.0f}]"
        details.append(f"{100 * gap.value:.0f}{spread} % over the least time (median)")
    if error := policy.tracking_error:
        spread = "" if error.low is None or error.high is None else f" [{1e3 * error.low:.1f}, {1e3 * error.high:.1f}]"
        details.append(f"tracking error {1e3 * error.value:.1f}{spread} mm")
    if policy.solver_failures:
        details.append(f"its solver failed {policy.solver_failures} times")
    if policy.missed_deadlines:
        details.append(f"{100 * policy.missed_deadlines:.2g} % of its deadlines missed")
    return details


def _policy_table(comparison: Comparison) -> Table:
    table = _table(
        f"{comparison.env}: {comparison.policies[0].planned} episodes of seed {comparison.seed}",
        "Second lines: training steps, 95 % intervals, 99th percentile. Steps: to the goal, where it was reached.",
        ["policy", "success", "return", "steps", "decision ms", "sees"],
    )
    for policy in comparison.policies:
        table.add_row(
            f"{policy.policy}\n{f'{policy.training_steps:,}' if policy.training_steps else 'untrained'}",
            _percent(policy.success),
            _plain(policy.episode_return),
            _plain(policy.steps_to_goal),
            f"{policy.decision_ms_p50:.3f}\n{policy.decision_ms_p99:.3f}",
            policy.sees,
        )
    return table


def _paired_table(differences: list[PairedDifference]) -> Table:
    table = _table(
        "Paired differences, on the same episodes",
        "p: McNemar's exact test for equal success. Steps: over the episodes that both won.",
        ["a - b", "success", "only a / only b", "p", "return", "steps"],
    )
    for pair in differences:
        table.add_row(
            f"{pair.a}\n- {pair.b}",
            f"{100 * (pair.only_a - pair.only_b) / pair.episodes:+.1f} %",
            f"{pair.only_a} / {pair.only_b}",
            f"{pair.mcnemar_p:.2g}",
            _plain(pair.return_difference, "+"),
            _plain(pair.steps_difference, "+"),
        )
    return table


def _table(title: str, caption: str, headings: list[str]) -> Table:
    table = Table(title=title, caption=caption, title_justify="left", caption_justify="left", box=SIMPLE_HEAD)
    table.padding, table.show_edge, table.pad_edge = (0, 1, 0, 0), False, False
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    table.columns[0].justify = "left"
    return table


def _percent(estimate: Estimate | None) -> str:
    if estimate is None:
        return "-"
    low, high = (None if bound is None else 100 * bound for bound in (estimate.low, estimate.high))
    return f"{100 * estimate.value:.1f} %\n" + _interval(low, high)


def _plain(estimate: Estimate | None, sign: str = "") -> str:
    if estimate is None:
        return "-"
    return f"{_short(estimate.value, sign)}\n" + _interval(estimate.low, estimate.high, sign)


def _interval(low: float | None, high: float | None, sign: str = "") -> str:
    return "unknown" if low is None or high is None else f"{_short(low, sign)} to {_short(high, sign)}"


def _short(value: float, sign: str = "") -> str:
    return f"{value:{sign}.{0 if abs(value) >= 99.95 else 1}f}"
