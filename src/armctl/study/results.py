"""Reads a study's folder back, without playing anything."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.options import option_value
from armctl.envs import ERROR
from armctl.episodes.stored import STORE, UNDISTURBED, StoredCell, StoredStudy, read_store
from armctl.study.comparison import Comparison, concluded
from armctl.study.names import COMPARISON, SUITE, SWEEP, WORST_CASE, cell_name
from armctl.study.study import Study
from armctl.study.task_results import Sweep
from armctl.verdict.facts import Facts

LONGEST_OPTION = 1_000
"""Characters of an option's text; to read long ones as Python takes much time and memory."""
UNFINISHED = "it is unfinished: the same command resumes it"


_FACTS, _STUDY, _TASKS = TypeAdapter(Facts), TypeAdapter(Study), TypeAdapter(dict[str, dict[str, Any]])


def read_comparison(folder: Path) -> Comparison:
    """Read the folder of a finished or interrupted comparison, or the undisturbed one of a sweep.

    Raises `ResultsError` if its store is missing or damaged, or holds another study.
    """
    study = read_study(folder)
    if study.kind not in (COMPARISON, SWEEP):
        raise ResultsError(f"{folder} holds a {study.kind}, not a comparison")
    (swept,) = study.tasks.values()
    return swept.comparisons[UNDISTURBED]


def read_study(folder: Path) -> Study:
    """Read the folder of a finished or interrupted study. A suite's task that is unfinished is in its failures.

    Raises `ResultsError` if its store is missing or damaged, or has no finished cell.
    """
    stored, path = read_store(folder), folder / STORE
    unfinished = ResultsError(f"{folder} is unfinished: the same command with --out {folder} resumes it")
    if not stored.record:
        raise unfinished
    try:
        study = _study(stored)
    except (ValueError, LookupError, ConfigurationError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise ResultsError(f"{path} cannot be read as results of a {stored.record.get('kind')}: {why}") from error
    if not study.tasks and study.kind != SUITE:
        raise unfinished
    return study


def _study(stored: StoredStudy) -> Study:
    """Raises `ValueError` for a record of other values than `Study.record`, or that does not belong to its cells."""
    record, tasks = stored.record, _TASKS.validate_python(stored.record.get("tasks"))
    sweeps = {env: {**task, "env": env, "seed": record.get("seed"), "comparisons": {}} for env, task in tasks.items()}
    study = _STUDY.validate_python(record | {"tasks": sweeps})
    if study.kind != SUITE and len(tasks) != 1:
        raise ValueError(f"it has {len(tasks)} tasks")
    levels: list[Sequence[Any]] = [levels for swept in study.tasks.values() for levels in swept.levels.values()]
    grids = [grid for swept in study.tasks.values() for grid in swept.grids]
    levels += [at for grid in grids for at in (grid.row_levels, grid.column_levels, (grid.rows, grid.columns))]
    if any(len(set(values)) < len(values) for values in (study.envs, *levels)):
        raise ValueError("it names a task or a level twice")
    if not all(axis.is_possible for swept in study.tasks.values() for axis in swept.axes):
        raise ValueError("it has a range of disturbances without levels")
    planned, study.tasks = study.tasks, {}
    for env in study.envs:
        if env in planned:
            _read_cells(planned[env], study.kind, stored)
        if env in planned and (planned[env].comparisons if study.kind == WORST_CASE else planned[env].undisturbed):
            study.tasks[env] = planned[env]
        else:
            study.failures.setdefault(env, UNFINISHED)
    return study


def _read_cells(swept: Sweep, kind: str, stored: StoredStudy) -> None:
    paired = (grid.setting(*levels) for grid in swept.grids for levels in grid.cells)
    for setting in stored.cells if kind == WORST_CASE else (UNDISTURBED, *swept.settings, *paired):
        cell = stored.cells.get(cell_name(kind, swept.env, setting))
        if cell is not None and cell.facts is not None:
            swept.comparisons[setting] = comparison = _comparison(cell)
            if (comparison.env, comparison.seed) != (swept.env, swept.seed):
                raise ValueError(f"its cell {setting} is of another environment or seed")


def _comparison(cell: StoredCell) -> Comparison:
    """Raises `ValueError` for facts that the episodes cannot have."""
    facts, policies, results = _FACTS.validate_python(cell.facts), cell.identity["policies"], cell.episodes
    members = [member for group in facts.groups.values() for member in group]
    low, high = facts.return_bounds or (-math.inf, math.inf)
    returns = results.column("total_reward")[results.column("outcome") != ERROR]
    rounding = 1e-9 * max(abs(low), abs(high)) if facts.return_bounds else 0.0
    fits = (
        min(map(len, facts.groups.values()), default=2) > 1
        and len(set(members) & set(policies)) == len(members)
        and set(results.column("policy").tolist()) <= set(facts.policies)
        and low <= high
        and ((returns >= low - rounding) & (returns <= high + rounding)).all()
        and results.column("length").max(initial=0) <= (facts.time_limit or math.inf)
    )
    if not fits:
        raise ValueError("what is known of it does not belong to its episodes: run the comparison again")
    options = _options(facts.env_options)
    return concluded(cell.identity, options, facts, results.sorted(policies), cell.runs)


def _options(texts: Mapping[str, str]) -> dict[str, Any]:
    for name, text in texts.items():
        if len(text) > LONGEST_OPTION:
            raise ValueError(
                f"its option {name[:LONGEST_OPTION]} has {len(text):,} characters, more than {LONGEST_OPTION:,}"
            )
    return {name: option_value(text) for name, text in texts.items()}
