"""Trains by a recipe, with one seed here, or with several by an engine's workers; each training gets a row in a ledger.

A training with its seed is the unit of work. Processes of this machine train in the folder itself, from which an
interrupted training resumes. A cluster's worker trains in a folder of its own, and sends the agent back; when it is
lost, another one begins anew.
"""

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from armctl.agents import FILES, AgentCard, read_card
from armctl.errors import FAILURES, ArmctlError, ConfigurationError, ResultsError, described
from armctl.evaluation.engines import Cluster, Engine
from armctl.evaluation.sending import relative
from armctl.evaluation.trials import TRIALS, add_trial, progress_of, read_trials, results_of, trial
from armctl.files import write_atomically
from armctl.learners import Recipe, load_learner
from armctl.simulation.threads import LIMIT

SETTINGS, CARD = "settings.json", "agent.json"
AWAY = Path("runs")
"""Where a cluster's worker trains, in its own folder."""


@dataclass(frozen=True)
class Job:
    """What trainings with several seeds share."""

    recipe: Recipe
    changed: Mapping[str, Any] = field(default_factory=dict)
    """What differs from the recipe as it was read, for the ledger."""
    resume: bool = False


@dataclass(frozen=True)
class Trained:
    """How a training has ended."""

    seed: int
    folder: Path
    card: AgentCard | None = None
    failure: str | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Of the folder, if that was on another machine."""
    rows: Sequence[Mapping[str, str]] = ()
    """For the ledger here, of that machine's."""


@contextlib.contextmanager
def recorded(job: Job, seed: int, folder: Path) -> Iterator[None]:
    """Give the training that is made in a folder a row in the ledger beside it, however it ends, unless it is refused.

    Raises `ResultsError` if that cannot be written.
    """
    recipe = job.recipe
    started = trial(recipe.name, recipe.learner, recipe.env, seed, job.changed, "finished")

    def record(ended: str, why: str, results: dict[str, Any]) -> None:
        if (folder / SETTINGS).exists():
            add_trial(folder.parent / TRIALS, started | {"ended": ended, "note": why} | results)

    try:
        yield
    except KeyboardInterrupt:
        record("interrupted", "", progress_of(folder))
        raise
    except ConfigurationError:  # it was refused, and is no training
        raise
    except Exception as error:
        try:
            record("failed", str(error), progress_of(folder))
        except ResultsError as untold:
            error.add_note(str(untold))
        raise
    record("finished", "", results_of(read_card(folder / CARD)))


def train_seeds(job: Job, folders: Mapping[int, Path], engine: Engine) -> Iterator[Trained]:
    """Train with each seed in its folder, and yield each training as it ends; on one core each.

    A job that resumes leaves out what has finished, and begins what has not begun. Raises `WorkersFailed`, and
    `ResultsError` if an agent that comes from another machine cannot be written.
    """
    waiting = {seed: folder for seed, folder in folders.items() if not (job.resume and _has_finished(folder))}
    for seed in folders.keys() - waiting.keys():
        yield Trained(seed, folders[seed], read_card(folders[seed] / CARD))
    if not isinstance(engine, Cluster):
        units = [(seed, folder.absolute(), False) for seed, folder in waiting.items()]
        ended = engine.run(_train, job, units)
    else:
        if begun := [folder for folder in waiting.values() if (folder / SETTINGS).exists()]:
            raise ConfigurationError(f"{begun[0]} holds a training already: a cluster's workers begin anew")
        sent, files = _for_sending(job)
        ended = engine.run(_train, sent, [(seed, AWAY / waiting[seed].name, True) for seed in waiting], files)
    left = dict(waiting)
    try:
        with contextlib.closing(ended):
            for one in ended:
                folder = left.pop(one.seed)
                _bring(one, folder)
                yield Trained(one.seed, folder, one.card, one.failure)
    except KeyboardInterrupt:
        for seed, folder in left.items():
            with contextlib.suppress(ArmctlError):
                _note_interrupted(job, seed, folder)
        raise


def _train(job: Job, seed: int, folder: Path, brings: bool) -> Trained:
    """Train in a worker."""
    os.environ[LIMIT] = "1"
    card, failure = None, None
    try:
        with recorded(job, seed, folder):
            resume = job.resume and (folder / SETTINGS).exists()
            card = load_learner(job.recipe.learner)(job.recipe, out=folder, seed=seed, resume=resume, progress=False)
    except FAILURES as error:
        failure = str(error) if isinstance(error, ArmctlError) else described(error)
    if not brings:
        return Trained(seed, folder, card, failure)
    files = {file.name: file.read_bytes() for file in folder.glob("*") if file.is_file() and file.name[0] != "."}
    ledger = folder.parent / TRIALS
    return Trained(seed, folder, card, failure, files, read_trials(ledger)[-1:] if ledger.exists() else ())


def _bring(one: Trained, folder: Path) -> None:
    """Write here what was written on another machine."""
    try:
        for name, content in one.files.items():
            folder.mkdir(parents=True, exist_ok=True)
            write_atomically(folder / Path(name).name, lambda path, content=content: path.write_bytes(content))  # type: ignore[misc]
    except OSError as error:
        raise ResultsError(f"the agent of seed {one.seed} cannot be written to {folder}: {error.strerror}") from error
    for row in one.rows:
        add_trial(folder.parent / TRIALS, row)


def _note_interrupted(job: Job, seed: int, folder: Path) -> None:
    if (folder / SETTINGS).exists():
        recipe = job.recipe
        row = trial(recipe.name, recipe.learner, recipe.env, seed, job.changed, "interrupted")
        add_trial(folder.parent / TRIALS, row | progress_of(folder))


def _has_finished(folder: Path) -> bool:
    return (folder / CARD).exists() and read_card(folder / CARD).evaluation is not None


def _for_sending(job: Job) -> tuple[Job, list[Path]]:
    """The job as another machine can use it, and the files that it names: a teacher's."""
    teacher = job.recipe.teacher
    if teacher is None or Path(teacher).suffix not in FILES:
        return job, []
    files = [Path(teacher).with_suffix(suffix) for suffix in FILES]
    recipe = job.recipe.changed(teacher=relative(teacher))
    return Job(recipe, job.changed, job.resume), [file for file in files if file.exists()]
