"""Plays a study: the one loop over cells."""

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from armctl.core.errors import ArmctlError, ResultsError
from armctl.envs import chosen_policy_seed
from armctl.episodes.record import EpisodeResult
from armctl.episodes.store import Store
from armctl.episodes.stored import stored_policy_seed
from armctl.policies import learners
from armctl.rollout.real_time import recorded_times
from armctl.study.cell import Recorder, Session, play_cell
from armctl.study.contenders import Task
from armctl.study.names import COMPARISON, SUITE
from armctl.study.options import StudyOptions
from armctl.study.output import check_output, remove_output, write_output
from armctl.study.plan import Cell, Plan, TaskPlan
from armctl.study.study import Study
from armctl.study.task_results import Sweep


def play(
    plan: Plan,
    out: str | Path | None,
    options: StudyOptions,
    progress: Callable[[Cell, EpisodeResult], None],
    recorder: Recorder | None = None,
) -> Study:
    """Play all cells of a plan, or resume them; with `out`, in a folder.

    `progress` is called with every finished episode, and first with those of an earlier run. A `recorder` keeps more of
    them than their results.

    Raises `ConfigurationError`, `AgentFileError`, and `ResultsError` as `Store` does; but in a suite, a task that
    cannot be played is among the failures, and the others are played.
    """
    folder, overwrite = None if out is None else Path(out), options.get("overwrite", False)
    if folder is not None:
        check_output(folder)
    stored = None if folder is None or overwrite else stored_policy_seed(folder)
    secret = chosen_policy_seed(options.get("policy_seed"), stored)
    study = Study.of(plan)
    with Store(folder, overwrite) as store:

        @functools.cache
        def on_first_cell() -> None:
            if folder is not None:
                remove_output(folder)
            store.describe(study.record() | {"interrupted": True})  # as it is read if this process is killed

        if plan.kind == SUITE:
            store.open(plan.seed, [cell.name for cell in plan.cells])
        session = Session(plan, store, secret, on_first_cell, progress, recorder or Recorder())
        _play_tasks(study, session)
        if plan.kind == SUITE:
            study.tasks = {env: swept for env, swept in study.tasks.items() if swept.comparisons}
        if folder is not None and study.cells:
            _write(store, folder, study)
    return study


def _play_tasks(study: Study, session: Session) -> None:
    """Play the tasks of a study, until one is interrupted."""
    for task in session.plan.tasks:
        try:
            _play_task(task, study.tasks[task.env], session)
        except ArmctlError as error:
            if session.plan.kind != SUITE:
                raise
            study.failures[task.env] = "; ".join(filter(None, (study.failures.get(task.env), str(error))))
        except KeyboardInterrupt:  # between two cells
            if session.plan.kind == COMPARISON:
                raise
            study.tasks[task.env].interrupted = True
        study.interrupted = study.tasks[task.env].interrupted
        if study.interrupted:
            break


def _write(store: Store, folder: Path, study: Study) -> None:
    """Write what was played, and tables of it for other programs."""
    try:
        store.describe(study.record())
        write_output(folder, study)
    except ResultsError as error:
        study.storage_failures.setdefault("results", str(error))


def _play_task(task: TaskPlan, swept: Sweep, session: Session) -> None:
    """Play the cells of a task into `swept`, until one is interrupted or cannot be written."""
    shared = Task()
    for cell in task.cells:
        if cell.repeats is not None:
            cell = _with_times(cell, swept, session.plan.episodes)
            if not cell.policies:
                continue
        try:
            comparison = play_cell(cell, session, shared)
        except ResultsError as error:
            if not swept.comparisons:
                raise
            swept.failures["results"] = str(error)
            return
        swept.comparisons[cell.setting] = comparison
        swept.failures |= {
            name if name == "results" else f"{cell.setting}: {name}": why for name, why in comparison.failures.items()
        }
        swept.interrupted = comparison.interrupted
        if swept.interrupted or "results" in comparison.failures:
            return


def _with_times(cell: Cell, swept: Sweep, episodes: int) -> Cell:
    """Return the cell with the decision times of the undisturbed one, without policies that lack some of them."""
    assert cell.real_time is not None
    assert swept.undisturbed is not None
    times = replace(cell.real_time, recorded=recorded_times(swept.undisturbed.results))
    missing = times.missing_recordings(cell.players, episodes)
    swept.failures |= {
        f"{cell.setting}: {policy}": f"no decision times of episode {k}" for policy, k in missing.items()
    }
    without = learners(list(missing), cell.groups)
    playing = {name: policy for name, policy in cell.policies.items() if name not in without}
    return replace(cell, real_time=times, policies=playing)
