"""The page of a suite: the verdict on each task, heat map, ranks, profiles, costs."""

import shlex
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from armctl.episodes.stored import UNDISTURBED
from armctl.report import style, suite_figures
from armctl.report.colours import INK
from armctl.report.pair_maps import Lead
from armctl.report.plots import Plot
from armctl.report.render import write_page
from armctl.report.suite_figures import CLASSICAL, HYBRID, LEARNED, SYMBOLS, CostPoint
from armctl.stats.across_tasks import (
    Choice,
    League,
    cell_rates,
    improvement,
    mean_over_tasks,
    success_profile,
)
from armctl.stats.intervals import Estimate
from armctl.study.names import task_name
from armctl.study.study import Study
from armctl.study.suite_headline import suite_headline
from armctl.study.suite_map import KindLead, kind_lead, map_columns, represented, setting_in_column
from armctl.study.suite_tables import success_test
from armctl.study.task_verdict import TaskVerdict, rule_of_choice
from armctl.verdict.summary import PolicySummary
from armctl.verdict.summary_tables import SPARED

ALL_TASKS = "all tasks"
ORDER = {"classical": 0, "hybrid": 1, "learned": 2}
"""Places of the kinds in a task's rows of the heat map."""
KIND_STYLES = {"classical": CLASSICAL, "learned": LEARNED, "hybrid": HYBRID}
"""Styles of the kinds in the map."""
THRESHOLDS = np.linspace(0.0, 1.0, 101)


def write_suite_page(suite: Study, folder: Path, out: Path, reports: Mapping[str, str]) -> None:
    """Write the page of a suite in `folder`. `reports` are the links to the tasks' own reports, by environment.

    Raises `ResultsError` if the page cannot be written.
    """
    verdicts = suite.verdicts
    names = list(dict.fromkeys(policy.family for verdict in verdicts for policy in verdict.policies))
    styles = suite_figures.family_styles(names)
    heads = map_columns([swept.levels for swept in suite.tasks.values()])
    headline, details = suite_headline(verdicts)
    page: dict[str, Any] = {
        "headline": headline,
        "details": details,
        "suite": suite,
        "chosen": rule_of_choice(verdicts, suite.quick),
        "test": success_test(verdicts),
        "folder": folder.resolve().name,
        "command": _command(suite),
        "tasks": [{"verdict": task, "short": task_name(task.env), "link": reports.get(task.env)} for task in verdicts],
        "heads": heads,
        "leads": [
            _leads(suite, verdict, heads, reports.get(verdict.env))
            for verdict in verdicts
            if verdict.pairs or verdict.hybrid_pairs
        ],
        "kinds": [
            KIND_STYLES[kind] for kind in KIND_STYLES if any(kind in represented(verdict) for verdict in verdicts)
        ],
        "heat": [_heat(suite, verdict, heads, reports.get(verdict.env)) for verdict in verdicts if verdict.cells],
        "families": _families(verdicts, names),
        "improvement": _improvement(verdicts),
        "ranks": [_ranks(league, styles) for league in suite.leagues],
        "profile": _profile(verdicts),
        "profile_styles": [CLASSICAL, LEARNED],
        "costs": _costs(verdicts, styles),
        "styles": list(styles.values()),
        "symbols": dict(
            zip((task_name(task.env) for task in verdicts), _symbols(verdicts, SYMBOLS.values()), strict=True)
        ),
    }
    write_page(out, "suite.html.j2", page)


def _command(suite: Study) -> str:
    envs = " ".join(f"--env {shlex.quote(env)}" for env in suite.envs)
    extent = f"--until decided --at-most {suite.episodes}" if suite.stops_early else f"--episodes {suite.episodes}"
    if suite.undisturbed_episodes is not None:  # the numbers are the usual ones
        extent = "--until decided"
    return f"armctl suite {envs} {'--quick ' if suite.quick else ''}{extent} --seed {suite.seed}"


def _leads(suite: Study, verdict: TaskVerdict, heads: Sequence[tuple[str, int]], link: str | None) -> dict[str, Any]:
    """Return a task's row of the map: the kind that leads in each column."""
    levels = suite.tasks[verdict.env].levels
    settings = [(UNDISTURBED, None), *(setting_in_column(levels, head) for head in heads)]
    return {
        "task": task_name(verdict.env),
        "link": link,
        "levels": ["" if at is None or at[1] is None else f"{at[1]:g}" for at in settings],
        "cells": [_lead(None if at is None else kind_lead(verdict, at[0])) for at in settings],
    }


def _lead(lead: KindLead | None) -> Lead:
    """Return a cell of the map."""
    if lead is None:
        return Lead("\u2013", "not compared")
    names = " against ".join(lead.policies.values())
    if not lead.kind:
        return Lead("=", f"{names}: the same success")
    state = "significant" if lead.certain else "equivalent" if lead.equivalent else "not significant"
    text = f"{lead.points:+.0f}{'' if lead.certain else lead.text[-2:]}"
    return Lead(text, f"{names}: {lead.kind} leads, {state}", KIND_STYLES[lead.kind].colour, lead.certain)


def _heat(suite: Study, verdict: TaskVerdict, heads: Sequence[tuple[str, int]], link: str | None) -> dict[str, Any]:
    """Return a task's rows of the heat map: for each policy, its success in percent in each column, None where unknown.

    It is `spared` where the disturbance does not reach the policy.
    """
    levels = suite.tasks[verdict.env].levels
    settings: list[tuple[str, str] | None] = [(UNDISTURBED, "")]
    for head in heads:
        at = setting_in_column(levels, head)
        settings.append(None if at is None else (at[0], f"{at[1]:g}"))
    rows = [
        (policy.policy, [None if at is None else _cell_value(verdict, policy.policy, at[0]) for at in settings])
        for policy in sorted(verdict.policies, key=lambda policy: ORDER[policy.side])
    ]
    levels_shown = [None if at is None else at[1] for at in settings]
    return {"task": task_name(verdict.env), "link": link, "levels": levels_shown[1:], "rows": rows}


def _cell_value(verdict: TaskVerdict, policy: str, setting: str) -> float | str | None:
    return SPARED if policy in verdict.spared.get(setting, ()) else _percent(verdict, policy, setting)


def _percent(verdict: TaskVerdict, policy: str, setting: str) -> float | None:
    table = verdict.cells.get(setting)
    if table is None or policy not in table or table[policy].isna().all():
        return None
    return 100 * float(table[policy].mean())


def _families(verdicts: Sequence[TaskVerdict], names: Sequence[str]) -> list[tuple[str, list[float | None]]]:
    """Return each family's mean success in percent in each task, over all settings and members."""
    return [(name, [_mean_success(verdict, _members(verdict, name)) for verdict in verdicts]) for name in names]


def _members(verdict: TaskVerdict, name: str) -> list[str]:
    return [policy.policy for policy in verdict.policies if policy.family == name]


def _mean_success(verdict: TaskVerdict, policies: Sequence[str]) -> float | None:
    cells = [_percent(verdict, policy, setting) for setting in verdict.cells for policy in policies]
    values = [cell for cell in cells if cell is not None]
    return sum(values) / len(values) if values else None


def _pairs(verdicts: Sequence[TaskVerdict]) -> list[tuple[TaskVerdict, Choice, Choice]]:
    return [
        (verdict, verdict.classical, verdict.learned)
        for verdict in verdicts
        if verdict.pairs and verdict.classical and verdict.learned
    ]


def _improvement(verdicts: Sequence[TaskVerdict]) -> Plot | None:
    improvements = {
        task_name(verdict.env): improvement(verdict.shared_cells, classical, learned)
        for verdict, classical, learned in _pairs(verdicts)
    }
    means = {task: mean_over_tasks([values]) for task, values in improvements.items()}
    means[ALL_TASKS] = mean_over_tasks(list(improvements.values()))
    rows = {name: mean for name, mean in means.items() if mean is not None}
    if not rows:
        return None
    colours = dict.fromkeys(rows, CLASSICAL.colour) | {ALL_TASKS: INK}
    return Plot(suite_figures.intervals(rows, colours), _alt_text(rows, "probability that classical does better"))


def _ranks(league: League, styles: style.Styles) -> Plot:
    colours = {name: styles[name].colour for name in league.ranks}
    alt_text = _alt_text(league.ranks, "rivals beaten")
    return Plot(suite_figures.intervals(league.ranks, colours), alt_text, ", ".join(league.tasks))


def _alt_text(rows: Mapping[str, Estimate], label: str) -> str:
    return f"{label}: " + "; ".join(f"{name} {estimate.value:.1%}" for name, estimate in rows.items())


def _profile(verdicts: Sequence[TaskVerdict]) -> Plot | None:
    pairs = _pairs(verdicts)
    if not pairs:
        return None
    lines = [
        (CLASSICAL, [rate for verdict, classical, _ in pairs for rate in cell_rates(verdict.shared_cells, classical)]),
        (LEARNED, [rate for verdict, _, learned in pairs for rate in cell_rates(verdict.shared_cells, learned)]),
    ]
    profiles = [(style, success_profile(rates, THRESHOLDS)) for style, rates in lines]
    figure = suite_figures.profiles(profiles, THRESHOLDS)
    return Plot(figure, "Share of tasks and settings with at least some success")


def _costs(verdicts: Sequence[TaskVerdict], styles: style.Styles) -> list[Plot]:
    """Success against decision time, and against the decisions of training, where these are known."""
    symbols = dict(zip((verdict.env for verdict in verdicts), _symbols(verdicts, SYMBOLS), strict=True))

    def points(cost: Any) -> list[CostPoint]:
        return [
            CostPoint(
                policy.policy, task_name(verdict.env), styles[policy.family], symbols[verdict.env], success / 100,
                float(known_cost),
            )
            for verdict in verdicts
            for policy in verdict.policies
            if (success := _mean_success(verdict, [policy.policy])) is not None
            and (known_cost := cost(policy)) is not None
        ]  # fmt: skip

    timed, trained = points(attrgetter("control_step_ms")), points(_decisions)
    if not timed:
        return []
    ms, min_decisions = suite_figures.MIN_MS, suite_figures.MIN_DECISIONS
    missing = {policy.policy for verdict in verdicts for policy in verdict.policies if _decisions(policy) is None}
    left_out = f" Not shown, trained on data or by unknown decisions: {', '.join(sorted(missing))}." if missing else ""
    return [
        Plot(suite_figures.cost_plane(timed, "time of a control step, ms", "ms", ms),
             "Success against decision time", "Decision time"),
        Plot(suite_figures.cost_plane(trained, "decisions in simulation, for training", "decisions", min_decisions),
             "Success against training", "Training", f"Without training: on the left.{left_out}"),
    ]  # fmt: skip


def _decisions(policy: PolicySummary) -> int | None:
    """Return the decisions of a policy's training, 0 without any; None for agents that learned without simulation."""
    return (policy.training.total.decisions or None) if policy.training.steps else 0


def _symbols(verdicts: Sequence[TaskVerdict], symbols: Any) -> list[str]:
    """Return a symbol for each task; further ones begin anew."""
    listed = list(symbols)
    return [listed[i % len(listed)] for i in range(len(verdicts))]
