"""Cells as a study: a sweep if conditions are levels of disturbances, a suite if both kinds of policies play."""

import math
import re
from collections.abc import Mapping
from dataclasses import replace

from armctl.episodes.stored import UNDISTURBED
from armctl.study.comparison import Comparison
from armctl.study.names import SUITE, setting_name
from armctl.study.study import Study
from armctl.study.task_results import Sweep
from armctl.verdict.tables import Remark, Table

NOMINAL = {"", "none", "nominal", "undisturbed", "baseline", "clean", "default", "normal"}
"""Names of the condition without a disturbance, in lower case."""
LEVEL = re.compile(r"(?P<disturbance>.*\S)\s*[-= ]\s*(?P<level>[+]?\d+(\.\d+)?)\s*\S{0,4}")
"""Form of a condition that is a level, such as `payload-2.0`, `payload = 2` or `delay 40 ms`."""

FIXED_ONLY = (
    "What these cells say as a sweep or a suite is left out: its tests hold for a fixed number of episodes only."
)

Cells = Mapping[tuple[str, str], Comparison]
"""Comparisons by task and condition."""


def study_parts(cells: Cells, same_episodes: bool) -> list[Table | Remark]:
    """Return the tables and sentences of a sweep or a suite, if the cells are one; else nothing.

    A sweep compares each policy with itself undisturbed: on the `same_episodes` in all cells, or unpaired ones. Its
    tests, and those of a suite, are for a fixed number of episodes, so that a remark stands in their place otherwise.
    """
    first = next(iter(cells.values()))
    if any(pair.any_number for comparison in cells.values() for pair in comparison.differences):
        return [Remark(FIXED_ONLY, "note")] if _sweep(cells) or _suite(cells) else []
    if (sweep := _sweep(cells)) is not None and (same_episodes or not first.facts.paired):
        return [part for part in sweep.document().parts if isinstance(part, Table) or part.kind != "note"]
    if (study := _suite(cells)) is None:
        return []
    return [
        replace(part, title=f"{len(study.tasks)} tasks, classical against learned")
        if isinstance(part, Table) and part.key == "tasks"
        else part
        for part in study.document().parts
    ]


def _sweep(cells: Cells) -> Sweep | None:
    """Return a sweep of one task with an undisturbed condition and levels of disturbances; None for other cells."""
    tasks, comparisons, levels = {task for task, _ in cells}, dict[str, Comparison](), dict[str, list[float]]()
    for (_, condition), comparison in cells.items():
        match = LEVEL.fullmatch(condition)
        if condition.lower() in NOMINAL:
            comparisons[UNDISTURBED] = comparison
        elif match is not None and math.isfinite(level := float(match["level"])):
            levels.setdefault(match["disturbance"], []).append(level)
            comparisons[setting_name(match["disturbance"], level)] = comparison
    if len(tasks) > 1 or len(comparisons) < len(cells) or UNDISTURBED not in comparisons or not levels:
        return None
    ordered = {name: [0.0, *sorted(set(at) - {0.0})] for name, at in levels.items()}
    if any(len(at) - 1 != len(levels[name]) for name, at in ordered.items()):
        return None
    return Sweep(tasks.pop(), 0, ordered, dict.fromkeys(levels, "0 = undisturbed"), "", comparisons, {}, False)


def _suite(cells: Cells) -> Study | None:
    """Return a suite of several tasks, in each of which both kinds play, and success is known; None for others."""
    for comparison in cells.values():
        kinds = {policy.side for policy in comparison.policies}
        if len(cells) < 2 or len(kinds) < 2 or not all(policy.success for policy in comparison.policies):
            return None
    tasks = {
        comparison.env: Sweep(comparison.env, 0, {}, {}, "", {UNDISTURBED: comparison}, {}, False)
        for comparison in cells.values()
    }
    episodes = max(comparison.facts.planned for comparison in cells.values())
    return Study(SUITE, 0, episodes, [*tasks], False, tasks, {}, False)
