"""Records a policy's episodes as a dataset, in one of several formats, so that nothing finished is lost.

Each finished episode is a file in the folder `unfinished`. At the end, the dataset is assembled of them there, moved
into its place, and `unfinished` is deleted. So a dataset is whole, and an interrupted collection resumes.
"""

import contextlib
import json
import shutil
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

from armctl import DEFAULT_ENV
from armctl.core.errors import EnvironmentFailed, ResultsError
from armctl.core.files import LOCK, bounded_text, one_writer, unsealed
from armctl.core.seeds import check_training_data_seed
from armctl.datasets.demonstrations import Demonstration, demonstrate
from armctl.datasets.formats import Format, load_format, load_formats
from armctl.datasets.minari import UNFINISHED, check_recordable
from armctl.datasets.parallel import RecordedEpisode, WorldsAsAsked, demonstrate_in_workers
from armctl.datasets.unfinished import IDENTITY, OTHER_DATASET, Unfinished
from armctl.envs import chosen_policy_seed, full_id
from armctl.episodes.failures import PolicyFailed
from armctl.episodes.stored import POLICY_SEED
from armctl.policies import PolicyFactory, policy_name
from armctl.rollout.parallel import WorkerConfig, check_sendable
from armctl.rollout.rollouts import build_policy, check_counts
from armctl.runtime.engines import engine_of
from armctl.runtime.folder import OTHERWISE, claim
from armctl.runtime.identity import identity, reasons_not_to_resume
from armctl.runtime.provenance import versions
from armctl.runtime.workers import WorkersFailed
from armctl.study.options import StudyOptions, checked_options


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

    After an interrupt (Ctrl-C), a failing policy or lost workers, the dataset has the episodes that were finished.
    After these, a full disk or the end of the process, the same call resumes, and gives the same dataset as one without
    interruption. `progress` is called with the number of finished episodes.

    Raises `ConfigurationError`, `AgentFileError`, `PolicyFailed`, `WorkersFailed`, and `ResultsError` if `out` holds
    another dataset (unless `overwrite`), cannot be written, has another writer, or if no episode was finished.
    """
    checked_options(options, CollectOptions)
    kind = load_format(format)
    libraries = kind.library_versions()
    worlds, workers, env_options = options.get("worlds", 1), options.get("workers", 1), options.get("env_options") or {}
    engine = engine_of(workers)
    check_counts(episodes=episodes, worlds=worlds, **({"workers": workers} if isinstance(workers, int) else {}))
    check_training_data_seed(seed)
    folder, name, overwrite = Path(out).absolute(), policy_name(policy), options.get("overwrite", False)
    worlds = min(worlds, episodes)
    secret = chosen_policy_seed(options.get("policy_seed"), None if overwrite else _stored_policy_seed(folder))
    with contextlib.closing(WorldsAsAsked(env, worlds if engine.is_local else 1, env_options)) as interfaces:
        vec_env = interfaces.requested
        check_recordable(vec_env)
        actor = build_policy(policy, vec_env, name, secret)
        vec_env.reset(seed=seed)  # raises for an invalid seed, before anything is written
        if not engine.is_local:
            check_sendable({name: policy})
        local_identity = identity(full_id(env), env_options, seed, {name: policy}, {name: actor}, vec_env)
        about = kind.describe(folder, env, env_options, vec_env) | {
            "algorithm_name": name, "sees": actor.sees, "seed": seed, "versions": versions() | libraries,
            "identity": local_identity | {"format": format, POLICY_SEED: str(secret)},
        }  # fmt: skip

        def play(numbers: Sequence[int]) -> Generator[RecordedEpisode, None, None]:
            if engine.is_local:
                return demonstrate(actor, vec_env, numbers, seed, name)
            config = WorkerConfig(env, worlds, env_options, seed, secret, engine.workers, interfaces=WorldsAsAsked)
            return demonstrate_in_workers(policy, actor, interfaces, config, name, numbers, engine)

        collection = _record(play, folder, kind, about, episodes, progress, overwrite)
    if not collection.episodes:
        raise ResultsError(f"no episode was finished: {out} was not written")
    return collection


def _record(
    play: Callable[[Sequence[int]], Generator[RecordedEpisode, None, None]],
    folder: Path,
    kind: Format,
    about: Mapping[str, Any],
    episodes: int,
    progress: Callable[[int], None],
    overwrite: bool,
) -> Collection:
    """Play what a folder lacks, and assemble the dataset of all that is finished. Raises what ends the playing."""
    with _claimed(folder, kind, overwrite):
        if (finished := _finished(folder, kind, about["identity"], episodes)) is not None:
            return finished
        unfinished = Unfinished(folder / UNFINISHED, about["identity"])
        if beyond := [number for number in unfinished.outcomes if number >= episodes]:
            raise ResultsError(
                f"{folder} already holds episode {max(beyond)}, beyond the {episodes} asked for: ask for more, "
                f"{OTHERWISE}"
            )
        resumed, interrupted = len(unfinished.outcomes), False
        waiting = [number for number in range(episodes) if number not in unfinished.outcomes]
        failure: Exception | None = None
        try:
            progress(resumed)
            with contextlib.closing(play(waiting)) as stream:
                for result, demonstration in stream if waiting else ():
                    unfinished.add(result.episode, result.outcome, demonstration)
                    progress(len(unfinished.outcomes))
        except KeyboardInterrupt:
            interrupted = True
            unfinished.count_again()
        except (PolicyFailed, EnvironmentFailed, WorkersFailed) as error:
            failure = error
        finally:
            if not unfinished.outcomes:
                unfinished.remove()
        if unfinished.outcomes:
            _assemble(folder, kind, unfinished, about)
        if len(unfinished.outcomes) == episodes:
            unfinished.remove()
        if failure is not None:
            raise failure
    return Collection(folder, len(unfinished.outcomes), unfinished.steps, unfinished.successes, resumed, interrupted)


@contextlib.contextmanager
def _claimed(folder: Path, kind: Format, overwrite: bool) -> Iterator[None]:
    """Keep other processes from writing to the folder; with `overwrite`, delete its dataset, of whatever format."""
    with one_writer(folder):
        formats = [other for other in load_formats().values() if other is kind or (folder / other.MANIFEST).exists()]
        names = dict.fromkeys(name for other in formats for name in (*other.PARTS, UNFINISHED))
        parts = [folder / name for name in names]
        if link := next((part for part in parts if part.is_symlink()), None):
            raise ResultsError(f"{link} is a symbolic link, through which armctl does not write: choose another folder")
        for part in parts if overwrite else ():
            if part.exists():
                shutil.rmtree(part)
        try:
            yield
        finally:
            if not any(part.exists() for part in parts):
                (folder / LOCK).unlink(missing_ok=True)
                with contextlib.suppress(OSError):
                    folder.rmdir()  # fails if it holds something else


def _stored_policy_seed(folder: Path) -> int | None:
    """Return the policy seed of the dataset in a folder, finished or not; None if there is none that can be read."""
    manifests = (folder / UNFINISHED / IDENTITY, *(folder / kind.MANIFEST for kind in load_formats().values()))
    return next((seed for path in manifests if (seed := _policy_seed_in(path)) is not None), None)


def _policy_seed_in(manifest: Path) -> int | None:
    try:
        values = unsealed(bounded_text(manifest))
        return int(values.get("identity", values)[POLICY_SEED])
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None


def _finished(folder: Path, kind: Format, local_identity: Mapping[str, Any], episodes: int) -> Collection | None:
    """Return the dataset that this call would make, if it is there already; None if some of it is missing.

    Raises `ResultsError` if another dataset is there.
    """
    if (folder / UNFINISHED).exists():
        return None
    for name, other in load_formats().items():
        if other is not kind and (folder / other.MANIFEST).exists():
            raise ResultsError(f"{folder} already holds a dataset in the format {name}: {OTHERWISE}")
    if not any((folder / part).exists() for part in kind.PARTS):
        return None
    values = claim(folder / kind.MANIFEST, local_identity, OTHER_DATASET, reasons=reasons_not_to_resume)
    if values is None:
        raise ResultsError(f"{folder} already holds a part of a dataset: {OTHERWISE}")
    if (stored_count := values["total_episodes"]) != episodes:
        raise ResultsError(f"{folder} already holds a dataset, of {stored_count} episodes, not {episodes}: {OTHERWISE}")
    return Collection(folder, episodes, values["total_steps"], values["successes"], resumed=episodes)


def _assemble(folder: Path, kind: Format, unfinished: Unfinished, about: Mapping[str, Any]) -> None:
    """Make the dataset of the finished episodes. Raises `ResultsError`, and then keeps the episodes."""
    numbers = sorted(unfinished.outcomes)

    def episodes() -> Iterator[tuple[Demonstration, dict[str, Any]]]:
        for number in numbers:
            episode, outcome = unfinished.read(number), unfinished.outcomes[number]
            attributes = {
                "seed": about["seed"],
                "options/episode": number,
                "outcome": outcome,
                "success": episode.success,
            }
            yield episode, attributes

    counts = {
        "total_episodes": len(numbers),
        "total_steps": unfinished.steps,
        "outcomes": dict(sorted(Counter(unfinished.outcomes.values()).items())),
        "successes": unfinished.successes,
    }
    built_parts = [unfinished.folder / part for part in kind.PARTS]
    try:
        for old in (*built_parts, *(folder / part for part in kind.PARTS)):
            if old.exists():
                shutil.rmtree(old)
        kind.write_dataset(unfinished.folder, episodes(), json.loads(json.dumps({**about, **counts})))
        for part in built_parts:
            if part.exists():
                part.rename(folder / part.name)
    except OSError as error:
        for part in built_parts:
            shutil.rmtree(part, ignore_errors=True)
        raise unfinished.not_written(error) from error
