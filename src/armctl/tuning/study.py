"""Tunes: asks Optuna for values, lets an engine's workers measure them, and writes down whatever was tried."""

import contextlib
import dataclasses
import os
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
import tomli_w
from optuna.trial import FrozenTrial, TrialState

from armctl.core.errors import ConfigurationError, os_errors_as
from armctl.core.files import inside, write_atomically
from armctl.core.search_space import with_values
from armctl.runtime.engines import Cluster, Engine, engine_of
from armctl.training.trials import TRIALS, add_trial, check_trials, trial_row
from armctl.tuning.candidates import Candidate
from armctl.tuning.journal import FAILURE, FOLDER, PROCESS, SCORES, SECONDS, joined
from armctl.tuning.trials import TrialOutcome, distributions, measure, measure_away

FOLDERS = "trials"
IN_A_ROW = 3
"""So many failed trials one after the other end the tuning: something is wrong with more than their values."""


@dataclass(frozen=True)
class TuningOutcome:
    """Result of a tuning so far."""

    candidate: Candidate
    study: optuna.Study
    folder: Path
    interrupted: bool = False

    @property
    def trials(self) -> list[FrozenTrial]:
        """All that have ended, but for those that were lost with their processes."""
        return [trial for trial in self.study.get_trials(deepcopy=False) if SECONDS in trial.user_attrs]

    @property
    def finished(self) -> list[FrozenTrial]:
        """Those that have a value."""
        return [trial for trial in self.trials if trial.state is TrialState.COMPLETE]

    @property
    def processor_seconds(self) -> float:
        """Spent by all trials."""
        return float(sum(trial.user_attrs[SECONDS] for trial in self.trials))

    @property
    def best(self) -> FrozenTrial | None:
        """The trial with the highest value, of equal ones the first; None if none was finished."""
        return max(self.finished, key=lambda trial: (trial.value, -trial.number), default=None)

    @property
    def present_trial(self) -> FrozenTrial | None:
        """The trial with the present values, if it was finished."""
        return next((trial for trial in self.finished if trial.params == self.candidate.present), None)

    @property
    def best_file(self) -> Path:
        """File with the best values, as soon as they are better than the present ones."""
        return self.folder / f"{Path(self.candidate.name).stem}_tuned.toml"


def tune(
    candidate: Candidate,
    out: str | Path,
    *,
    trials: int | None = None,
    hours: float | None = None,
    seed: int = 0,
    workers: int | Engine = 1,
    resume: bool = False,
    progress: Callable[[TuningOutcome], None] = lambda so_far: None,
) -> TuningOutcome:
    """Try values until `trials` have ended, or they have spent so many processor `hours`, whichever comes first.

    The first trial is the present values. Then Optuna proposes values by the tree-structured Parzen estimator in its
    multivariate form (Bergstra et al., "Algorithms for hyper-parameter optimization", NIPS 2011; Falkner et al.,
    "BOHB", ICML 2018), after some at random, by `seed`. A trial that is worse than the median of those before at the
    same point is pruned. Trials that run when the budget is spent are finished. What earlier calls, or other processes
    at the same time, have tried in the folder `out` counts.

    The folder holds `journal.log`, which is Optuna's, `trials.csv`, with a row for each trial, what the trials write,
    and the best values in a TOML file. `progress` is told of each trial that has ended. A trial whose process died is
    tried again, from its beginning; with `resume`, its trainings continue from their checkpoints. These are pickles,
    which can run any code when they are loaded: resume only tunings of your own.

    Raises `ConfigurationError`, also if the present values fail, `ResultsError` if the folder cannot be written or
    holds another tuning, and `WorkersFailed`.
    """
    _check_budget(trials, hours)
    engine, folder, candidate = engine_of(workers), Path(out), dataclasses.replace(candidate, resumes=resume)
    check_trials(folder / TRIALS)
    with joined(candidate, folder, seed) as (study, process):
        outcome, running = TuningOutcome(candidate, study, folder), dict[int, optuna.Trial]()

        def proposals() -> Iterator[tuple[Any, ...]]:
            while _is_left(outcome, trials, hours):
                trial = study.ask(distributions(candidate.space))
                running[trial.number] = trial
                trial.set_user_attr(PROCESS, process)
                name = trial.user_attrs.get(FOLDER) if candidate.resumes else None  # of a lost trial, tried again
                name = name or _unused_name(folder / FOLDERS, trial.number)
                trial.set_user_attr(FOLDER, name)
                others = [other for other in outcome.trials if other.state is not TrialState.FAIL]
                yield trial.number, trial.params, home / name, others

        if isinstance(engine, Cluster):
            home = Path(FOLDERS)
            sent, files = candidate.for_sending()
            measuring = engine.run(measure_away, (sent, candidate.code), proposals(), files)
        else:
            home = inside(folder, FOLDERS).absolute()
            measuring = engine.run(measure, candidate, proposals())
        try:
            with os_errors_as(f"{folder} could not be written any further"), contextlib.closing(measuring) as results:
                for measured in results:
                    _note(outcome, running.pop(measured.number), measured)
                    progress(outcome)
        except KeyboardInterrupt:
            outcome = dataclasses.replace(outcome, interrupted=True)
    return outcome


def _check_budget(trials: int | None, hours: float | None) -> None:
    if trials is None and hours is None:
        raise ConfigurationError("a tuning needs a budget: a number of trials, or processor hours")
    for name, budget in {"trials": trials, "hours": hours}.items():
        if budget is not None and not budget > 0:
            raise ConfigurationError(f"{name} must be more than 0, not {budget}")


def _unused_name(folder: Path, number: int) -> str:
    """Return a name for a trial's folder that nothing in a folder has."""
    name = f"{number:04d}"
    return f"{name}-{uuid.uuid4().hex[:8]}" if os.path.lexists(folder / name) else name


def _is_left(outcome: TuningOutcome, trials: int | None, hours: float | None) -> bool:
    """Return whether there is budget for another trial. Failed and lost ones do not count."""
    trials_so_far = [trial for trial in outcome.study.get_trials(deepcopy=False) if trial.state is not TrialState.FAIL]
    begun_trials = [trial for trial in trials_so_far if trial.state is not TrialState.WAITING]
    few = trials is None or len(begun_trials) < trials
    return few and (hours is None or outcome.processor_seconds < 3600 * hours)


def _note(outcome: TuningOutcome, trial: optuna.Trial, measured: TrialOutcome) -> None:
    """Write down what became of a trial. Raises `ConfigurationError` if trials fail whatever their values are."""
    candidate = outcome.candidate
    for step, score in measured.reports.items():
        trial.report(score, step)
    about = {SECONDS: measured.processor_seconds, SCORES: list(measured.scores), FAILURE: measured.failure}
    for name, value in about.items():
        trial.set_user_attr(name, value)
    state = TrialState.FAIL if measured.failure else TrialState.PRUNED if measured.pruned else TrialState.COMPLETE
    outcome.study.tell(trial, measured.value if state is TrialState.COMPLETE else None, state)
    _add_to_ledger(outcome, trial, measured)
    best = outcome.best
    if best is not None and best.params != candidate.present:  # after each trial: the file has how many there were
        write_atomically(outcome.best_file, _document(outcome, best))
    if measured.failure:
        last = outcome.trials[-IN_A_ROW:]
        if trial.params == candidate.present:
            raise ConfigurationError(f"{candidate.name} fails with its present values: {measured.failure}")
        if len(last) == IN_A_ROW and all(trial.state is TrialState.FAIL for trial in last):
            raise ConfigurationError(f"{IN_A_ROW} trials in a row failed, the last one so: {measured.failure}")


def _add_to_ledger(outcome: TuningOutcome, trial: optuna.Trial, measured: TrialOutcome) -> None:
    candidate = outcome.candidate
    changed = {path: value for path, value in trial.params.items() if value != candidate.present[path]}
    ending = "failed" if measured.failure else "pruned" if measured.pruned else "finished"
    scores = ", ".join(f"{score:.4g}" for score in measured.scores)
    note = f"tuning, trial {measured.number}: {measured.failure or f'{candidate.score} {scores}'.strip()}"
    row = trial_row(candidate.name, candidate.learner, candidate.env, None, changed, ending, note)
    add_trial(outcome.folder / TRIALS, row | {"minutes": round(measured.processor_seconds / 60, 3)})


def _document(outcome: TuningOutcome, best: FrozenTrial) -> str:
    """Return the candidate's file with the best values, and in its first lines where they come from."""
    candidate, present = outcome.candidate, outcome.present_trial
    comparison = f"; {present.value:.5g} with the values of {candidate.name}" if present else ""
    head = (
        f"# {candidate.name}, tuned by `armctl tune`: trial {best.number}.\n"
        f"# Judged by {candidate.judged_by}: {best.value:.5g}{comparison}.\n\n"
    )
    content = with_values(candidate.content, best.params)
    content["tuned"] = {"trials": len(outcome.trials), "minutes": round(outcome.processor_seconds / 60, 1)}
    return head + tomli_w.dumps({name: value for name, value in content.items() if value not in ({}, [])})
