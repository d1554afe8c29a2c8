"""Trains by a recipe, with one seed here, or with several by an engine's workers; each training gets a row in a ledger.

A training with its seed is the unit of work. Processes of this machine train in the folder itself, from which an
interrupted training resumes. A cluster's worker trains in a folder of its own, and sends the agent back; when it is
lost, another one begins anew.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from armctl.agents import CARD, FILES, AgentCard, read_card
from armctl.core.errors import FAILURES, ArmctlError, ConfigurationError, ResultsError, described, os_errors_as
from armctl.core.files import write_atomically
from armctl.envs import task_of
from armctl.runtime.engines import Cluster, Engine
from armctl.runtime.identity import checksums_of_code
from armctl.runtime.sending import relative
from armctl.runtime.workers import check_same_identity
from armctl.simulation.threads import one_thread
from armctl.training.learners import Callback, Recipe, load_learner
from armctl.training.trials import TRIALS, add_trial, check_trials, progress_of, read_trials, results_of, trial_row

SETTINGS = "settings.json"
"""Name of the file of a training's recipe and options: where it is, one has begun."""
AWAY = Path("runs")
"""Folder in which a cluster's worker trains, within its own."""


@dataclass(frozen=True)
class TrainingJob:
    """Settings that trainings with several seeds share."""

    recipe: Recipe
    changed: Mapping[str, Any] = field(default_factory=dict)
    """Differences from the recipe as it was read, for the ledger."""
    resume: bool = False
    code: Mapping[str, str] = field(default_factory=dict)
    """Checksums of the learner's code, to be found alike on other machines."""

    def record(self, seed: int, folder: Path, ending: str, why: str, results: dict[str, Any]) -> None:
        """Give a training in a folder, if one has begun there, a row in the ledger beside it. Raises `ResultsError`."""
        if (folder / SETTINGS).exists():
            recipe = self.recipe
            row = trial_row(recipe.name, recipe.learner, recipe.env, seed, self.changed, ending, why)
            add_trial(folder.parent / TRIALS, row | results)


@dataclass(frozen=True)
class TrainingOutcome:
    """Result of a training."""

    seed: int
    folder: Path
    card: AgentCard | None = None
    failure: str | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Files of the folder, if that was on another machine."""
    rows: Sequence[Mapping[str, str]] = ()
    """Rows of that machine's ledger, for the one here."""


@contextlib.contextmanager
def log_trial(job: TrainingJob, seed: int, folder: Path) -> Iterator[None]:
    """Give the training that is made in a folder a row in the ledger beside it, however it ends, unless it is refused.

    Raises `ResultsError` if that cannot be written.
    """
    check_trials(folder.parent / TRIALS)
    try:
        yield
    except KeyboardInterrupt:
        job.record(seed, folder, "interrupted", "", progress_of(folder))
        raise
    except ConfigurationError:  # it was refused, and is no training
        raise
    except Exception as error:
        try:
            job.record(seed, folder, "failed", str(error), progress_of(folder))
        except ResultsError as ledger_error:
            error.add_note(str(ledger_error))
        raise
    job.record(seed, folder, "finished", "", results_of(read_card(folder / CARD)))


def train_seeds(job: TrainingJob, folders: Mapping[int, Path], engine: Engine) -> Iterator[TrainingOutcome]:
    """Train with each seed in its folder, and yield each training as it ends; on one core each.

    A job that resumes leaves out what has finished, and begins what has not begun. Raises `WorkersFailed`, and
    `ResultsError` if an agent that comes from another machine cannot be written.
    """
    remaining = dict(folders)
    for seed, folder in folders.items() if job.resume else ():
        if (card := finished(folder)) is not None:
            yield TrainingOutcome(seed, remaining.pop(seed), card)
    if not isinstance(engine, Cluster):
        units = [(seed, folder.absolute(), False) for seed, folder in remaining.items()]
        outcomes = engine.run(_train, job, units)
    else:
        if begun_folders := [folder for folder in remaining.values() if (folder / SETTINGS).exists()]:
            raise ConfigurationError(f"{begun_folders[0]} holds a training already: a cluster's workers begin anew")
        recipe, files = for_sending(job.recipe)
        sent = replace(job, recipe=recipe, code=code_of(recipe))
        outcomes = engine.run(
            _train, sent, [(seed, AWAY / folder.name, True) for seed, folder in remaining.items()], files
        )
    try:
        with contextlib.closing(outcomes):
            for outcome in outcomes:
                folder = remaining.pop(outcome.seed)
                _bring(outcome, folder)
                yield TrainingOutcome(outcome.seed, folder, outcome.card, outcome.failure)
    except KeyboardInterrupt:
        for seed, folder in remaining.items():
            with contextlib.suppress(ArmctlError):
                job.record(seed, folder, "interrupted", "", progress_of(folder))
        raise


def _train(job: TrainingJob, seed: int, folder: Path, brings: bool) -> TrainingOutcome:
    """Train in a worker."""
    if brings:
        check_same_identity(job.code, code_of(job.recipe))
    card, failure = None, None
    try:
        with log_trial(job, seed, folder):
            card = train_here(job.recipe, seed, folder, job.resume)
    except FAILURES as error:
        failure = str(error) if isinstance(error, ArmctlError) else described(error)
    if not brings:
        return TrainingOutcome(seed, folder, card, failure)
    files = {file.name: file.read_bytes() for file in folder.glob("*") if file.is_file() and file.name[0] != "."}
    ledger = folder.parent / TRIALS
    return TrainingOutcome(seed, folder, card, failure, files, read_trials(ledger)[-1:] if ledger.exists() else ())


def _bring(outcome: TrainingOutcome, folder: Path) -> None:
    """Write here what was written on another machine."""
    with os_errors_as(f"the agent of seed {outcome.seed} cannot be written to {folder}"):
        for name, content in outcome.files.items():
            folder.mkdir(parents=True, exist_ok=True)
            write_atomically(folder / Path(name).name, content)
    for row in outcome.rows:
        add_trial(folder.parent / TRIALS, row)


def finished(folder: Path) -> AgentCard | None:
    """Return the card of the training in a folder; None if it has not finished. Raises `AgentFileError`."""
    card = read_card(folder / CARD) if (folder / CARD).exists() else None
    return card if card and card.evaluation else None


def train_here(recipe: Recipe, seed: int, folder: Path, resume: bool, on_evaluation: Callback = None) -> AgentCard:
    """Train in a worker, on one core; with `resume`, go on from what is in the folder, if there is anything."""
    with one_thread():
        has_begun = resume and (folder / SETTINGS).exists()
        train = load_learner(recipe.learner)
        return train(recipe, out=folder, seed=seed, resume=has_begun, progress=False, on_evaluation=on_evaluation)


def processor_seconds() -> float:
    """Return the processor time of all threads of this process, and of its finished child processes."""
    return sum(os.times()[:4])


def code_of(recipe: Recipe) -> dict[str, str]:
    """Checksums of the code by which a recipe trains, by file name."""
    return checksums_of_code([load_learner(recipe.learner), task_of(recipe.env)])


def for_sending(recipe: Recipe) -> tuple[Recipe, list[Path]]:
    """Return a recipe as another machine can use it, and the files that it names: a teacher's."""
    teacher = recipe.teacher
    if teacher is None or Path(teacher).suffix not in FILES:
        return recipe, []
    files = (Path(teacher).with_suffix(suffix) for suffix in FILES)
    return recipe.changed(teacher=relative(teacher)), [file for file in files if file.exists()]
