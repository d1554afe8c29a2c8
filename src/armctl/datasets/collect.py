"""Records a policy's episodes as a dataset: a study of one cell, whose recorder keeps the observations.

So nothing that is finished is lost, and an interrupted collection resumes. `results.sqlite` stays beside the dataset.
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

from armctl import DEFAULT_ENV
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.registration import remember_named
from armctl.core.seeds import check_training_data_seed
from armctl.datasets.formats import load_format
from armctl.datasets.recorder import DatasetRecorder, totals
from armctl.envs import full_id
from armctl.episodes.failures import PolicyDisqualified, PolicyFailed
from armctl.episodes.stored import UNDISTURBED
from armctl.policies import PolicyFactory, policy_name
from armctl.runtime.provenance import versions
from armctl.runtime.workers import WorkersFailed
from armctl.study.comparison import Comparison
from armctl.study.names import COMPARISON
from armctl.study.options import StudyOptions, checked_options
from armctl.study.plan import Cell, Plan, TaskPlan, extent
from armctl.study.run import play


@dataclass
class Collection:
    """The result of `collect`."""

    folder: Path
    episodes: int = 0
    steps: int = 0
    successes: int = 0
    resumed: int = 0
    """Episodes that an earlier run had finished."""
    interrupted: bool = False


class CollectOptions(StudyOptions, total=False):
    """Options of a collection: those of studies.

    `overwrite` replaces the dataset in the folder. `policy_seed` is by default that of the dataset in the folder, or a
    new one, and stands in the dataset's metadata. `workers` play blocks of 4 episodes per world, which come back whole,
    so that an interrupt loses those that are not finished.
    """

    env_options: Mapping[str, Any] | None
    """Options of the environment, by name."""


def collect(
    policy: str | Path | PolicyFactory,
    env: str = DEFAULT_ENV,
    *,
    episodes: int,
    out: str | Path,
    seed: int = 0,
    format: str = "minari",
    progress: Callable[[int], None] = lambda finished: None,
    **options: Unpack[CollectOptions],
) -> Collection:
    """Write a policy's episodes 0 to `episodes` - 1 of `seed` to a dataset in the folder `out`.

    The episodes are in the order of their numbers, and the same however many worlds play at once, and wherever.
    `format` is an installed one:

    - `minari`: `minari.MinariDataset(out / "data")` opens it. So does `minari.load_dataset(out.name)` if
      `MINARI_DATASETS_PATH` is the parent folder and `out.name` ends with a version, such as `-v0`.
    - `lerobot`: `LeRobotDataset("any/name", root=out)` opens it, and so does Rerun (`rerun OUT`).

    After an interrupt (Ctrl-C), a policy that fails in some episodes, or lost workers, the dataset has the episodes
    that were finished. After these, a full disk or the end of the process, the same call resumes, and gives the same
    dataset as one without interruption. `progress` is called with the number of finished episodes. The results are in
    `out` too, as `compare` writes them.

    Raises `ConfigurationError`, `AgentFileError`, `PolicyFailed`, `WorkersFailed`, and `ResultsError` if `out` holds
    another dataset (unless `overwrite`), cannot be written, has another writer, or if no episode was finished.
    """
    checked_options(options, CollectOptions)
    kind = load_format(format)
    libraries = kind.library_versions()
    folder, name, env, env_options = Path(out).absolute(), policy_name(policy), full_id(env), options.get("env_options")
    remember_named(env)
    cell = Cell(UNDISTURBED, env, dict(env_options or {}), {name: policy})
    if len(cell.players) > 1:
        raise ConfigurationError(f"a dataset is of one policy, not of {name}: choose one of {', '.join(cell.players)}")
    check_training_data_seed(seed)
    shared = extent(episodes, seed, options)
    plan = Plan(COMPARISON, [TaskPlan(env, [cell])], **shared, envs=[env])
    metadata = {"algorithm_name": name, "seed": seed, "versions": versions() | libraries}
    recorder = DatasetRecorder(folder, format, kind, metadata, episodes, options.get("overwrite", False))
    finished = itertools.count(1)
    study = play(plan, folder, options, lambda cell, result: progress(next(finished)), recorder)
    comparison: Comparison = study.cells[UNDISTURBED]
    _raise_failures(comparison, recorder)
    results = comparison.results
    if not len(results):
        raise ResultsError(f"no episode was finished: there is no dataset in {out}")
    return Collection(folder, *totals(results), comparison.facts.resumed, comparison.facts.interrupted)


def _raise_failures(comparison: Comparison, recorder: DatasetRecorder) -> None:
    """Raise what went wrong while a cell was played."""
    for source, why in comparison.failures.items():
        if source == "results":
            raise ResultsError(why)
        if source == "workers":
            raise WorkersFailed(why)
        failure = (PolicyDisqualified if source in comparison.facts.disqualified else PolicyFailed)(why)
        failure.add_note(comparison.tracebacks.get(source, ""))
        raise failure
    if recorder.failure is not None:
        raise recorder.failure
