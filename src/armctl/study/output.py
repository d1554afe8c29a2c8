"""Output of a study for other programs: tables and a summary. armctl does not read them back."""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armctl.core.errors import ResultsError, os_errors_as
from armctl.core.files import write_atomically
from armctl.episodes.output import DECISIONS, EPISODES, EPISODES_PARQUET, write_csv
from armctl.episodes.stored import STORE, UNDISTURBED
from armctl.study.comparison import Comparison
from armctl.study.names import COMPARISON, SUITE, SWEEP
from armctl.study.study import Study
from armctl.study.task_results import COLUMNS

if TYPE_CHECKING:
    import pandas as pd

SUMMARY, POINTS, PAIRS, WORST_CASES = "summary.json", "sweep.csv", "pairs.csv", "worst_case.csv"
NAMES = (SUMMARY, POINTS, PAIRS, WORST_CASES, EPISODES, DECISIONS, EPISODES_PARQUET)
"""All that may be written from a store."""


def write_output(folder: Path, study: Study) -> None:
    """Write the tables `episodes.csv`, `decisions.csv` and `sweep.csv`, and `summary.json`. Raises `ResultsError`."""
    summaries = {name: summary(comparison) for name, comparison in study.cells.items()}
    results = {name: comparison.results for name, comparison in study.cells.items()}
    is_comparison = study.kind == COMPARISON
    about = summaries[UNDISTURBED] if is_comparison else {**study.record(), "cells": summaries}
    with os_errors_as(f"tables could not be written to {folder}"):
        write_csv(folder, results[UNDISTURBED] if is_comparison else results)
        write_atomically(folder / SUMMARY, json.dumps(about, indent=2) + "\n")
        if study.kind in (SWEEP, SUITE):
            write_atomically(folder / POINTS, _points(study).to_csv(index=False))
        if records := [record for swept in study.tasks.values() for part in swept.maps for record in part.records]:
            write_atomically(folder / PAIRS, csv_of(records))


def check_output(folder: Path) -> None:
    """Raise `ResultsError` if a folder has no store, and files that would be written: they are somebody else's."""
    for name in NAMES if not os.path.lexists(folder / STORE) else ():
        if os.path.lexists(folder / name):
            raise ResultsError(f"{folder / name} would be replaced, and armctl did not write it: choose another folder")


def remove_output(folder: Path) -> None:
    """Remove all that may have been written from a store, while more is played. Raises `ResultsError`."""
    with os_errors_as(f"results cannot be written to {folder}"):
        for name in NAMES:
            (folder / name).unlink(missing_ok=True)


def _points(study: Study) -> "pd.DataFrame":
    """Return the rows of `sweep.csv`; those of a suite begin with the environment."""
    import pandas as pd

    tables = [swept.points for swept in study.tasks.values()]
    if study.kind == SUITE:
        tables = [table.assign(env=env)[["env", *COLUMNS]] for env, table in zip(study.tasks, tables, strict=True)]
    return pd.concat(tables) if len(tables) > 1 else tables[0]


def csv_of(records: Sequence[Mapping[str, Any]]) -> str:
    """Return records with the same keys as CSV."""
    import pandas as pd

    return pd.DataFrame(records).to_csv(index=False)


def summary(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as JSON values: settings, results, versions and machine."""
    facts = {name: value for name, value in vars(comparison.facts).items() if name != "policies"}
    return {
        "env": comparison.env,
        "seed": comparison.seed,
        **facts,
        "policy_seed": str(comparison.facts.policy_seed),
        "notes": comparison.notes,
        "policies": [asdict(policy) for policy in comparison.policies],
        "differences": [asdict(difference) for difference in comparison.differences],
        "runs": [asdict(run) for run in comparison.runs],
        "comparison": comparison.identity,
    }
