"""Reads a study's folder back, without playing anything."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, TypeAdapter, ValidationError

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.options import option_value
from armctl.envs import ERROR
from armctl.episodes.stored import STORE, UNDISTURBED, StoredCell, StoredStudy, read_store
from armctl.study.comparison import Comparison, concluded
from armctl.study.facts import Facts, Finite
from armctl.study.plan import COMPARISON, SUITE, SWEEP
from armctl.study.study import Study, cell_name
from armctl.study.task_results import Sweep

LONGEST_OPTION = 1_000
"""Characters of an option's text; to read long ones as Python takes much time and memory."""
UNFINISHED = "it is unfinished: the same command resumes it"


@dataclass(frozen=True)
class _Task:
    levels: dict[str, list[Finite]]
    units: dict[str, str]
    recorded: str
    failures: dict[str, str]
    interrupted: bool


@dataclass(frozen=True)
class _Record:
    """Values of `Study.record`."""

    kind: Annotated[str, Field(pattern=f"^({COMPARISON}|{SWEEP}|{SUITE})$")]
    seed: int
    episodes: int
    envs: list[str]
    quick: bool
    failures: dict[str, str]
    interrupted: bool
    tasks: dict[str, _Task]


_FACTS, _RECORD = TypeAdapter(Facts), TypeAdapter(_Record)


def read_comparison(folder: Path) -> Comparison:
    """Read the folder of a finished or interrupted comparison, or the undisturbed one of a sweep.

    Raises `ResultsError` if its store is missing or damaged, or holds a suite.
    """
    study = read_study(folder)
    if study.kind == SUITE:
        raise ResultsError(f"{folder} holds a suite, not a comparison")
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
        record = _RECORD.validate_python(stored.record)
        study = _study(record, stored)
    except (ValueError, LookupError, ConfigurationError) as error:
        why = error.errors()[0]["msg"] if isinstance(error, ValidationError) else error
        raise ResultsError(f"{path} cannot be read as results of a {stored.record.get('kind')}: {why}") from error
    if not study.tasks and study.kind != SUITE:
        raise unfinished
    return study


def _study(record: _Record, stored: StoredStudy) -> Study:
    """Raises `ValueError` for a record that does not belong to its cells."""
    study = Study(
        record.kind, record.seed, record.episodes, record.envs, record.quick, {}, dict(record.failures),
        record.interrupted,
    )  # fmt: skip
    if record.kind != SUITE and len(record.tasks) != 1:
        raise ValueError(f"it has {len(record.tasks)} tasks")
    for env in record.envs:
        swept = _task(env, record, stored) if env in record.tasks else None
        if swept is not None and swept.undisturbed is not None:
            study.tasks[env] = swept
        else:
            study.failures.setdefault(env, UNFINISHED)
    return study


def _task(env: str, record: _Record, stored: StoredStudy) -> Sweep:
    task = record.tasks[env]
    swept = Sweep(env, record.seed, task.levels, task.units, task.recorded, {}, dict(task.failures), task.interrupted)
    for setting in (UNDISTURBED, *swept.settings):
        cell = stored.cells.get(cell_name(record.kind, env, setting))
        if cell is not None and cell.facts is not None:
            swept.comparisons[setting] = comparison = _comparison(cell)
            if (comparison.env, comparison.seed) != (env, record.seed):
                raise ValueError(f"its cell {setting} is of another environment or seed")
    return swept


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
