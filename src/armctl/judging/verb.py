"""Judges results made anywhere: `judge` reads episodes, and returns the verdict on them."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.core.options import make_options
from armctl.episodes.stored import STORE
from armctl.judging.cells import ALL, Terms, comparisons_of
from armctl.judging.columns import FIELDS
from armctl.judging.frames import rows_of_frame
from armctl.judging.read import files_of, policy_names, read_file
from armctl.judging.result import Judgement
from armctl.judging.studies import study_parts
from armctl.judging.trials import trials_of
from armctl.study.comparison import concluded
from armctl.study.names import COMPARISON

if TYPE_CHECKING:
    import pandas as pd


def judge(
    results: "str | Path | Sequence[str | Path] | pd.DataFrame",
    columns: Mapping[str, str] | None = None,
    **terms: Any,
) -> Judgement:
    """Return the verdict on episodes that exist: in files, in folders of files, or in a frame with a row for each.

    Files are CSV, TSV, Parquet, JSON or JSON lines with a row for each episode, LeRobot's `eval_info.json`, vla-eval's
    and robo-evals' JSON, Stable-Baselines3's `evaluations.npz` and Monitor files, or folders of such or of armctl's
    results. A row has at least a policy, unless its file is all of one policy, and one of success, return and time.
    Columns are found by their usual names (`armctl.judging.columns.FIELDS`); `columns` names others, by field. `terms`
    are the fields of `armctl.judging.cells.Terms`, such as `baseline="old"`.

    Policies with equal episodes (task, condition, seed, episode) are compared in pairs, others as separate samples;
    several trainings of a policy are one learner; each task and condition has its own verdict. What was assumed is
    among the notes, and what is unknown in no verdict.

    Raises `ConfigurationError`, with file, line and reason, for everything that is not clear.
    """
    judging_terms, chosen = make_options(Terms, terms), dict(columns or {})
    for name in chosen:
        if name not in FIELDS:
            raise unknown_name("field of a trial", name, FIELDS)
    if not isinstance(results, str | Path | Sequence):
        parts, defaults = [rows_of_frame(results)], {"the frame": "the frame"}
    else:
        paths = [results] if isinstance(results, str | Path) else [*results]
        if not paths:
            raise ConfigurationError("there is nothing to judge: name files or folders of results")
        if len(paths) == 1 and not chosen and _is_own(paths[0]):
            return _of_own(Path(paths[0]), judging_terms)
        played_folders = [Path(path) for path in paths if _is_own(path)]
        files = files_of(path for path in paths if Path(path) not in played_folders)
        parts = [rows for file in files for rows in read_file(file)]
        if played_folders:
            from armctl.judging.formats.own import read

            parts += [rows for folder in played_folders for rows in read(folder)]
        defaults = policy_names(files)
    all_trials = trials_of(parts, chosen, defaults, judging_terms.policies_in_columns)
    if len({trial.policy for trial in all_trials.trials}) == 1:
        all_trials.note("There is one policy only: name the files of another one too.")
    cells = comparisons_of(all_trials, judging_terms)
    if len(cells) == 1:
        return Judgement({cells[0][0].name: cells[0][1]}, cells[0][1])
    overall = cells.pop()[1] if cells[-1][0].name == ALL else None
    same_episodes = len({cell.episodes for cell, _ in cells}) == 1 and cells[0][0].paired
    by_condition = {(cell.task, cell.condition): comparison for cell, comparison in cells}
    study = study_parts(by_condition, same_episodes)
    return Judgement({cell.name: comparison for cell, comparison in cells}, overall, study)


def _is_own(path: str | Path) -> bool:
    """Return True for a results folder of armctl's; False also for a name that no file can have."""
    return os.path.isfile(Path(path) / STORE)


def _of_own(folder: Path, terms: Terms) -> Judgement:
    """Return the judgement of a folder that armctl played, with all that is known of it."""
    from armctl.study.results import read_study

    useless = [
        f"--{field.name.replace('_', '-')}"
        for field in fields(Terms)
        if field.name not in ("baseline", "margin") and getattr(terms, field.name) != field.default
    ]
    if useless:
        raise ConfigurationError(f"{folder} has armctl's own results, for which there is no {', no '.join(useless)}")
    study = read_study(folder)
    cells = {}
    for name, comparison in study.cells.items():
        if terms.baseline not in (None, *comparison.names):
            raise unknown_name("policy in these results", terms.baseline, comparison.names)
        facts = replace(comparison.facts, baseline=terms.baseline or comparison.facts.baseline, margin=terms.margin)
        cells[name] = concluded(comparison.identity, comparison.env_options, facts, comparison.results, comparison.runs)
    if study.kind == COMPARISON:
        return Judgement(cells, next(iter(cells.values())))
    return Judgement(cells, None, played_study=study.result)
