"""A tuning's folder: Optuna's journal, in which any number of processes work at once, and lose nothing when they die.

They may be on several machines that share the folder. Each holds a lock while it lives, so that the others know whose
trials are lost. These are tried again. The journal may come from a stranger: it is checked against the search space.
"""

import contextlib
import math
import uuid
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import filelock
import numpy as np
import optuna
from optuna.samplers import TPESampler
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from armctl.core.errors import ResultsError, described
from armctl.core.files import FORMAT, LOCK, inside, open_without_links, sealed, write_atomically
from armctl.runtime.folder import claim
from armctl.runtime.identity import checksum_of_core
from armctl.runtime.provenance import versions
from armctl.tuning.candidates import Candidate
from armctl.tuning.trials import distributions

FORMAT_NUMBER = 1
"""Format of `tuning.json`."""
JOURNAL, TUNING, PROCESSES = "journal.log", "tuning.json", "processes"
PROCESS, FOLDER, SECONDS, SCORES, FAILURE = "process", "folder", "processor_seconds", "scores", "failure"
"""Notes on a trial."""
PATIENCE = 60.0
"""s to wait for another process that joins or leaves."""


class TrialNotes(BaseModel):
    """Notes on a trial, as they may be."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)

    process: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")] | None = None
    """The process that tries it."""
    folder: Annotated[str, Field(pattern=r"^[0-9]{4,10}(-[0-9a-f]{8})?$")] | None = None
    processor_seconds: Annotated[float, Field(ge=0)] | None = None
    scores: list[float] = []
    failure: str | None = None


@contextlib.contextmanager
def joined(candidate: Candidate, folder: Path, seed: int) -> Iterator[tuple[optuna.Study, str]]:
    """Yield the study in a folder, which is made if there is none, and the name of this process while it works on it.

    Raises `ResultsError` if the folder cannot be written, is damaged, or holds another tuning.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with contextlib.ExitStack() as leaving:
        try:
            others = inside(folder, PROCESSES)
            others.mkdir(parents=True, exist_ok=True)
            with filelock.FileLock(folder / LOCK, timeout=PATIENCE):
                identity = _identity(candidate)
                claimed = claim(
                    folder / TUNING, identity, "another tuning", "choose another folder", format_number=FORMAT_NUMBER
                )
                if claimed is None:
                    write_atomically(folder / TUNING, sealed(identity))
                is_alone = not _living(others)
                if is_alone:
                    _mend(folder / JOURNAL)
                    Path(f"{folder / JOURNAL}.lock").unlink(missing_ok=True)  # of a process that died while it wrote
                name = uuid.uuid4().hex
                leaving.callback((others / name).unlink, missing_ok=True)
                leaving.enter_context(filelock.FileLock(others / name, timeout=0))
                with _damage(folder / JOURNAL):
                    study = _study(folder / JOURNAL, seed)
                    _check_trials(study, candidate)
                    if not study.get_trials(deepcopy=False):
                        study.enqueue_trial(candidate.present)
                    _retry_lost(study, _living(others), is_alone)
        except filelock.Timeout:
            raise ResultsError(f"another process has kept {folder} locked for {PATIENCE:.0f} s") from None
        except OSError as error:
            raise ResultsError(f"{folder} cannot be written to: {error.strerror}") from error
        yield study, name


@contextlib.contextmanager
def _damage(journal: Path) -> Iterator[None]:
    try:
        yield
    except OSError:
        raise
    except Exception as error:  # Optuna reads what anybody may have written, and checks little of it
        raise ResultsError(f"{journal} is damaged ({described(error)}): choose another folder") from error


def _check_trials(study: optuna.Study, candidate: Candidate) -> None:
    """Raise `ValueError` for what this candidate's tuning does not write."""
    if study.directions != [optuna.study.StudyDirection.MAXIMIZE]:
        raise ValueError("it minimises, or has several scores")
    expected = distributions(candidate.space)
    for trial in study.get_trials(deepcopy=False):
        about = f"trial {trial.number}"
        if any(expected.get(path) != distribution for path, distribution in trial.distributions.items()):
            raise ValueError(f"{about} has another search space")
        if trial.state.is_finished() and trial.value is not None and trial.distributions.keys() != expected.keys():
            raise ValueError(f"{about} lacks values")
        for path, value in [*trial.params.items(), *trial.system_attrs.get("fixed_params", {}).items()]:
            if value not in candidate.space[path]:
                raise ValueError(f"{about} has {path} = {value!r}, outside its range")
        if trial.value is not None and not math.isfinite(trial.value):
            raise ValueError(f"{about} has the value {trial.value}")
        try:
            TrialNotes.model_validate(trial.user_attrs)
        except ValidationError as error:
            raise ValueError(f"the notes of {about} are not armctl's: {error.errors()[0]['msg']}") from error


def _study(journal: Path, seed: int) -> optuna.Study:
    open(journal, "ab", opener=open_without_links).close()
    storage = JournalStorage(JournalFileBackend(str(journal.absolute())))  # its lock is a link to the path
    study = optuna.create_study(study_name=TUNING, storage=storage, direction="maximize", load_if_exists=True)
    states = np.random.SeedSequence([seed, len(study.get_trials(deepcopy=False))]).generate_state(1)
    with warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
        study.sampler = TPESampler(seed=int(states[0]), multivariate=True, constant_liar=True)
    return study


def _identity(candidate: Candidate) -> dict[str, Any]:
    """Return the identity that trials in one folder share."""
    return {
        FORMAT: FORMAT_NUMBER,
        "name": candidate.name,
        "content": candidate.content,
        "space": {path: value_range.model_dump(mode="json") for path, value_range in candidate.space.items()},
        "judged": candidate.judged_by,
        "code": candidate.code,
        "versions": versions() | {"optuna": optuna.__version__},
        "source": checksum_of_core(),
    }


def _living(folder: Path) -> set[str]:
    """Names of the processes that hold their locks. The locks of others are removed."""
    living = set()
    for file in folder.iterdir():
        lock = filelock.FileLock(file)
        try:
            with lock.acquire(timeout=0):
                file.unlink(missing_ok=True)
        except filelock.Timeout:
            living.add(file.name)
    return living


def _mend(journal: Path) -> None:
    """Cut off the line at which a process died while it wrote."""
    if journal.exists():
        with open(journal, "r+b", opener=open_without_links) as file:
            content = file.read()
            file.truncate(content.rfind(b"\n") + 1)


def _retry_lost(study: optuna.Study, living: set[str], is_alone: bool) -> None:
    """End trials whose processes have died, and let their values be tried next."""
    for lost_trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        process = lost_trial.user_attrs.get(PROCESS)
        if process in living or (process is None and not is_alone):
            continue
        study.tell(lost_trial.number, state=TrialState.FAIL)
        kept = {name: value for name, value in lost_trial.user_attrs.items() if name == FOLDER}
        study.enqueue_trial(lost_trial.params, user_attrs=kept)
