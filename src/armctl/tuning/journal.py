"""A tuning's folder: Optuna's journal, in which any number of processes work at once, and lose nothing when they die.

They may be on several machines that share the folder. Each holds a lock while it lives, so that the others know whose
trials are lost. These are tried again, in the same folder: trainings that have begun there are resumed.
"""

import contextlib
import uuid
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import optuna
from optuna.samplers import TPESampler
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from armctl.core.errors import ResultsError
from armctl.core.files import FORMAT, LOCK, inside, open_without_links, sealed, write_atomically
from armctl.runtime.folder import claim
from armctl.runtime.identity import checksum_of_core
from armctl.runtime.provenance import versions
from armctl.tuning.candidates import Candidate

FORMAT_NUMBER = 1
"""Format of `tuning.json`."""
JOURNAL, TUNING, PROCESSES = "journal.log", "tuning.json", "processes"
PROCESS, FOLDER = "process", "folder"
"""Notes on a trial: the process that tries it, and its folder."""
PATIENCE = 60.0
"""s to wait for another process that joins or leaves."""


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
                name = uuid.uuid4().hex
                leaving.callback((others / name).unlink, missing_ok=True)
                leaving.enter_context(filelock.FileLock(others / name, timeout=0))
                study = _study(folder / JOURNAL, seed)
                if not study.get_trials(deepcopy=False):
                    study.enqueue_trial(candidate.present)
                _retry_lost(study, _living(others), is_alone)
        except filelock.Timeout:
            raise ResultsError(f"another process has kept {folder} locked for {PATIENCE:.0f} s") from None
        except OSError as error:
            raise ResultsError(f"{folder} cannot be written to: {error.strerror}") from error
        except (ValueError, KeyError, AssertionError) as error:
            raise ResultsError(f"{folder / JOURNAL} is damaged ({error}): choose another folder") from error
        yield study, name


def _study(journal: Path, seed: int) -> optuna.Study:
    open(journal, "ab", opener=open_without_links).close()
    storage = JournalStorage(JournalFileBackend(str(journal)))
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
