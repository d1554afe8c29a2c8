"""The page of a suite: the answer for each task, heat map, ranks, profiles, costs."""

import shlex
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from armctl.report import style, suite_figures
from armctl.report.colours import INK
from armctl.report.plots import Plot
from armctl.report.render import write_page
from armctl.report.suite_figures import CLASSICAL, LEARNED, SYMBOLS, CostPoint
from armctl.runtime.provenance import looks_in_words
from armctl.stats.across_tasks import (
    Choice,
    League,
    cell_rates,
    family,
    improvement,
    mean_over_tasks,
    success_profile,
)
from armctl.stats.intervals import Estimate
from armctl.study.answers import CHOSEN, Answer
from armctl.study.suite import Suite, folder_of
from armctl.study.sweep import UNDISTURBED, folder_name
from armctl.verdict.summary import PolicySummary
from armctl.verdict.summary_tables import SPARED

ALL_TASKS = "all tasks"
THRESHOLDS = np.linspace(0.0, 1.0, 101)


def write_suite_page(found: Suite, folder: Path, out: Path, reports: Mapping[str, str]) -> None:
    """Write the page of a suite in `folder`. `reports` are the links to the tasks' own reports, by environment.

    Raises `ResultsError` if the page cannot be written.
    """
    answers = found.answers
    names = list(dict.fromkeys(family(policy.policy) for one in answers for policy in one.policies))
    look, heads = suite_figures.family_looks(names), _heads(found)
    page: dict[str, Any] = {
        "headline": headline(answers),
        "suite": found,
        "chosen": CHOSEN,
        "folder": folder.resolve().name,
        "command": _command(found),
        "tasks": [{"answer": one, "short": folder_of(one.env), "link": reports.get(one.env)} for one in answers],
        "heads": heads,
        "heat": [_heat(found, one, heads, reports.get(one.env)) for one in answers if one.cells],
        "families": _families(answers, names),
        "improvement": _improvement(answers),
        "ranks": [_ranks(league, look) for league in found.leagues],
        "profile": _profile(answers),
        "profile_looks": [CLASSICAL, LEARNED],
        "costs": _costs(answers, look),
        "looks": list(look.values()),
        "symbols": dict(zip((folder_of(one.env) for one in answers), _symbols(answers, SYMBOLS.values()), strict=True)),
    }
    write_page(out, "suite.html.j2", page)


def headline(answers: Sequence[Answer]) -> str:
    """In how many tasks which kind is better in success, and in how many others it takes fewer steps.

    `answers` are corrected for all tasks, as `Suite.answers` is.
    """
    heads = [head for one in answers if (head := one.undisturbed)]
    if not heads:
        return "No task has both classical and learned results"
    classical, learned = (sum(head.better == sign for head in heads) for sign in (1, -1))
    open_ = len(heads) - classical - learned
    parts = [f"classical is better in {classical}", f"learned in {learned}", f"neither is shown to be in {open_}"]
    faster = [sum(head.faster == sign for head in heads) for sign in (1, -1)]
    said = [f"Of {len(heads)} task{'s' * (len(heads) > 1)}, by success, {', '.join(parts)}"]
    said += [f"there, classical takes fewer steps in {faster[0]}, learned in {faster[1]}"] if any(faster) else []
    looks = sorted({look for one in answers for look in one.looks})
    return "; ".join([*said, looks_in_words(looks)] if looks else said)


def _command(found: Suite) -> str:
    envs = " ".join(f"--env {shlex.quote(env)}" for env in found.envs)
    return f"armctl suite {envs} {'--quick ' if found.quick else ''}--episodes {found.episodes} --seed {found.seed}"


def _heads(found: Suite) -> list[tuple[str, int]]:
    """The columns of the heat map after the undisturbed one: a disturbance, and which of its levels."""
    columns: dict[str, int] = {}
    for swept in found.tasks.values():
        for name, levels in swept.levels.items():
            columns[name] = max(columns.get(name, 0), len(levels) - 1)
    return [(name, i) for name, count in columns.items() for i in range(1, count + 1)]


def _heat(found: Suite, one: Answer, heads: Sequence[tuple[str, int]], link: str | None) -> dict[str, Any]:
    """A task's rows of the heat map: for each policy, its success in percent in each column, None where unknown.

    It is `spared` where the disturbance does not reach the policy.
    """
    levels = found.tasks[one.env].levels
    settings: list[tuple[str, str] | None] = [(UNDISTURBED, "")]
    for name, i in heads:
        known = i < len(levels.get(name, ()))
        settings.append((folder_name(name, levels[name][i]), f"{levels[name][i]:g}") if known else None)
    rows = [
        (policy.policy, [None if at is None else _shown(one, policy.policy, at[0]) for at in settings])
        for policy in sorted(one.policies, key=lambda policy: policy.learned)
    ]
    shown = [None if at is None else at[1] for at in settings]
    return {"task": folder_of(one.env), "link": link, "levels": shown[1:], "rows": rows}


def _shown(one: Answer, policy: str, setting: str) -> float | str | None:
    return SPARED if policy in one.spared.get(setting, ()) else _percent(one, policy, setting)


def _percent(one: Answer, policy: str, setting: str) -> float | None:
    table = one.cells.get(setting)
    if table is None or policy not in table or table[policy].isna().all():
        return None
    return 100 * float(table[policy].mean())


def _families(answers: Sequence[Answer], names: Sequence[str]) -> list[tuple[str, list[float | None]]]:
    """For each family, its mean success in percent in each task, over all settings and members."""
    return [(name, [_mean_success(one, _members(one, name)) for one in answers]) for name in names]


def _members(one: Answer, name: str) -> list[str]:
    return [policy.policy for policy in one.policies if family(policy.policy) == name]


def _mean_success(one: Answer, policies: Sequence[str]) -> float | None:
    cells = [_percent(one, policy, setting) for setting in one.cells for policy in policies]
    known = [cell for cell in cells if cell is not None]
    return sum(known) / len(known) if known else None


def _both(answers: Sequence[Answer]) -> list[tuple[Answer, Choice, Choice]]:
    return [(one, one.classical, one.learned) for one in answers if one.heads and one.classical and one.learned]


def _improvement(answers: Sequence[Answer]) -> Plot | None:
    found = {
        folder_of(one.env): improvement(one.shared_cells, classical, learned)
        for one, classical, learned in _both(answers)
    }
    means = {task: mean_over_tasks([values]) for task, values in found.items()}
    means[ALL_TASKS] = mean_over_tasks(list(found.values()))
    rows = {name: mean for name, mean in means.items() if mean is not None}
    if not rows:
        return None
    colours = dict.fromkeys(rows, CLASSICAL.colour) | {ALL_TASKS: INK}
    return Plot(suite_figures.intervals(rows, colours), _said(rows, "probability that classical does better"))


def _ranks(league: League, look: style.Looks) -> Plot:
    colours = {name: look[name].colour for name in league.ranks}
    said = _said(league.ranks, "rivals beaten")
    return Plot(suite_figures.intervals(league.ranks, colours), said, ", ".join(league.tasks))


def _said(rows: Mapping[str, Estimate], what: str) -> str:
    return f"{what}: " + "; ".join(f"{name} {one.value:.1%}" for name, one in rows.items())


def _profile(answers: Sequence[Answer]) -> Plot | None:
    both = _both(answers)
    if not both:
        return None
    lines = [
        (CLASSICAL, [rate for one, classical, _ in both for rate in cell_rates(one.shared_cells, classical)]),
        (LEARNED, [rate for one, _, learned in both for rate in cell_rates(one.shared_cells, learned)]),
    ]
    drawn = [(look, success_profile(rates, THRESHOLDS)) for look, rates in lines]
    return Plot(suite_figures.profiles(drawn, THRESHOLDS), "Share of tasks and settings with at least some success")


def _costs(answers: Sequence[Answer], look: style.Looks) -> list[Plot]:
    """Success against decision time, and against the decisions of training, where these are known."""
    symbols = dict(zip((one.env for one in answers), _symbols(answers, SYMBOLS), strict=True))

    def points(cost: Any) -> list[CostPoint]:
        return [
            CostPoint(
                policy.policy, folder_of(one.env), look[family(policy.policy)], symbols[one.env], success / 100,
                float(known),
            )
            for one in answers
            for policy in one.policies
            if (success := _mean_success(one, [policy.policy])) is not None
            and (known := cost(policy)) is not None
        ]  # fmt: skip

    timed, trained = points(attrgetter("decision_ms")), points(_decisions)
    if not timed:
        return []
    ms, least = suite_figures.LEAST_MS, suite_figures.LEAST_DECISIONS
    unknown = {policy.policy for one in answers for policy in one.policies if _decisions(policy) is None}
    left_out = f" Unknown: {', '.join(sorted(unknown))}." if unknown else ""
    return [
        Plot(suite_figures.cost_plane(timed, "mean decision, ms", "ms", ms), "Success against decision time",
             "Decision time"),
        Plot(suite_figures.cost_plane(trained, "decisions in simulation, for training", "decisions", least),
             "Success against training", "Training", f"Without training: on the left.{left_out}"),
    ]  # fmt: skip


def _decisions(policy: PolicySummary) -> int | None:
    return policy.training.total.decisions if policy.learned else 0


def _symbols(answers: Sequence[Answer], symbols: Any) -> list[str]:
    """A symbol for each task; further ones begin anew."""
    listed = list(symbols)
    return [listed[i % len(listed)] for i in range(len(answers))]


def task_folders(found: Suite) -> dict[str, str]:
    """The folder of each task that has results, by environment."""
    return {env: folder_of(env) for env in found.tasks}
