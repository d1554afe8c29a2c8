"""Writes and reads a policy's episodes as a Minari dataset.

Minari (Younis et al. 2024) is Gymnasium's format for offline data: a folder with an HDF5 file and a JSON file. Reading
one unpickles nothing, and makes no environment from it.
"""

import contextlib
import copy
import re
import shutil
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from armctl import DEFAULT_ENV
from armctl.agents import shapes
from armctl.datasets.demonstrations import Demonstration, demonstrate
from armctl.envs import EpisodeVectorEnv, find_spec, make_worlds
from armctl.errors import ConfigurationError, ResultsError, missing_extra
from armctl.evaluation.provenance import versions
from armctl.evaluation.record import EpisodeResult
from armctl.policies import Policy, PolicyFactory, make_policy, policy_name

DATA = "data"
"""Minari's folder within the dataset's folder."""


@dataclass
class Collection:
    """The result of `collect`."""

    folder: Path
    episodes: int = 0
    steps: int = 0
    successes: int = 0
    interrupted: bool = False


def collect(
    policy: str | Path | PolicyFactory,
    env: str = DEFAULT_ENV,
    *,
    episodes: int,
    out: str | Path,
    seed: int = 0,
    worlds: int = 1,
    env_options: Mapping[str, Any] | None = None,
    progress: Callable[[EpisodeResult], None] | None = None,
) -> Collection:
    """Write a policy's episodes 0 to `episodes` - 1 of `seed` to a Minari dataset in the folder `out`.

    The episodes are in the order of their numbers, however many worlds play at once. `minari.MinariDataset(out /
    "data")` opens it. So does `minari.load_dataset(out.name)` if `MINARI_DATASETS_PATH` is the parent folder and
    `out.name` ends with a version, such as `-v0`. After an interrupt (Ctrl-C) or a failing policy, finished episodes
    are kept.

    Raises `ConfigurationError`, `AgentFileError`, `PolicyFailed`, and `ResultsError` if `out` already holds a dataset
    or cannot be written, or if no episode was finished.
    """
    storage_type = _minari().dataset.minari_storage.MinariStorage
    if episodes < 1 or worlds < 1:
        raise ConfigurationError(f"episodes and worlds must be at least 1, not {episodes} and {worlds}")
    collection, name = Collection(Path(out)), policy_name(policy)
    with contextlib.closing(make_worlds(env, min(worlds, episodes), env_options)) as made_env:
        made_env.reset(seed=seed)  # raises for an invalid seed, before anything is written
        made = make_policy(policy, made_env)
        with _Writer(storage_type, collection, made_env, env, env_options or {}, name, made, seed) as writer:
            try:
                for result, demonstration in demonstrate(made, made_env, episodes, seed, name):
                    writer.add(result, demonstration)
                    if progress is not None:
                        progress(result)
            except KeyboardInterrupt:
                collection.interrupted = True
    if not collection.episodes:
        raise ResultsError(f"no episode was finished: {out} was not written")
    return collection


class _Writer:
    """Writes episodes in the order of their numbers.

    It writes in a thread of its own, which interrupts do not reach, so that the dataset holds whole episodes only.
    """

    def __init__(
        self, storage_type: Any, collection: Collection, worlds: EpisodeVectorEnv, env: str,
        env_options: Mapping[str, Any], name: str, policy: Policy, seed: int,
    ) -> None:  # fmt: skip
        self._collection = collection
        self._data = collection.folder.resolve() / DATA  # Minari 0.5.4 cannot compute sizes under a relative path
        self._waiting: dict[int, tuple[EpisodeResult, Demonstration]] = {}
        self._next, self._outcomes, self._seed = 0, Counter[str](), seed
        try:
            self._data.mkdir(parents=True)
            self._storage = storage_type.new(
                self._data,
                observation_space=worlds.single_observation_space,
                action_space=worlds.single_action_space,
                env_spec=_spec(env, env_options),
                jpeg_encoding=False,  # it is lossy
            )
            self._storage.update_metadata(
                {
                    "dataset_id": _dataset_id(collection.folder),
                    "minari_version": _minari().__version__,
                    "algorithm_name": name,
                    "env": env,
                    "env_options": {option: str(value) for option, value in env_options.items()},
                    "interface": worlds.task.interface,
                    "sees": policy.sees,
                    "seed": seed,
                    "versions": versions() | {"minari": _minari().__version__},
                }
            )
        except FileExistsError as error:
            raise ResultsError(f"{collection.folder} already holds a dataset: choose another folder") from error
        except OSError as error:
            raise ResultsError(f"the dataset cannot be written to {collection.folder}: {error.strerror}") from error

    def __enter__(self) -> "_Writer":
        self._thread = ThreadPoolExecutor(1)
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self._thread.submit(lambda: self._write(sorted(self._waiting))).result()
        finally:
            self._thread.shutdown()
            if not self._collection.episodes:
                shutil.rmtree(self._data)
                with contextlib.suppress(OSError):
                    self._collection.folder.rmdir()  # fails if it holds something else

    def add(self, result: EpisodeResult, demonstration: Demonstration) -> None:
        """Write the episode as soon as all before it are finished."""
        self._waiting[result.episode] = (result, demonstration)
        ready = []
        while self._next in self._waiting:
            ready.append(self._next)
            self._next += 1
        if ready:
            self._thread.submit(self._write, ready).result()

    def _write(self, numbers: list[int]) -> None:
        from minari.data_collector import EpisodeBuffer

        for number in numbers:
            if number not in self._waiting:
                continue  # written by a job that an interrupt did not wait for
            result, episode = self._waiting[number]
            ended = np.arange(len(episode)) == len(episode) - 1
            buffer = EpisodeBuffer(
                seed=self._seed,
                options={"episode": number},
                observations=episode.observations,
                actions=episode.actions,
                rewards=episode.rewards,
                terminations=ended & episode.terminated,
                truncations=ended & (not episode.terminated),
                infos={},
            )
            try:
                self._storage.update_episodes([buffer])
                index = self._collection.episodes
                outcome = {"outcome": result.outcome, "success": episode.success}
                self._storage.update_episode_metadata([outcome], [index])
                self._outcomes[result.outcome] += 1
                successes = self._collection.successes + episode.success
                self._storage.update_metadata({"outcomes": dict(self._outcomes), "successes": successes})
            except OSError as error:
                raise ResultsError(
                    f"{self._collection.folder} could not be written any further: {error.strerror or error}"
                ) from error
            self._collection.episodes, self._collection.successes = index + 1, successes
            self._collection.steps += len(episode)
            del self._waiting[number]


def read_demonstrations(dataset: str | Path, worlds: EpisodeVectorEnv) -> list[Demonstration]:
    """All episodes of a Minari dataset, given by its folder, or by its id in Minari's own folder.

    Episodes without an entry `success` in their metadata count as successes. Raises `ConfigurationError` for a dataset
    that is missing or corrupt, or whose observations and actions are not those of `worlds`.
    """
    folder = _find(dataset)
    storage_type = _minari().dataset.minari_storage.MinariStorage
    try:
        metadata = storage_type.read_raw_metadata(folder)
        if not {"observation_space", "action_space"} <= set(metadata):
            raise ConfigurationError(f"the dataset {dataset} does not declare its observation and action spaces")
        storage = storage_type.read(folder)
        _check_fits(str(dataset), metadata, storage, worlds)
        indices = range(storage.total_episodes)
        descriptions = list(storage.get_episode_metadata(indices))
        episodes = [
            Demonstration(
                episode["observations"], episode["actions"], np.asarray(episode["rewards"], dtype=float),
                bool(np.any(episode["terminations"])), bool(description.get("success", True)),
            )
            for episode, description in zip(storage.get_episodes(indices), descriptions, strict=True)
        ]  # fmt: skip
    except ConfigurationError:
        raise
    except Exception as error:  # Minari, h5py and json raise many kinds of exceptions for broken files
        raise ConfigurationError(
            f"{dataset} is not a readable Minari dataset: {type(error).__name__}: {error}"
        ) from error
    if not episodes:
        raise ConfigurationError(f"the dataset {dataset} has no episodes")
    for i, episode in enumerate(episodes):
        _check_whole(f"episode {i} of the dataset {dataset}", episode, worlds)
    return episodes


def _find(dataset: str | Path) -> Path:
    from minari.storage.datasets_root_dir import get_dataset_path

    for folder in (Path(dataset) / DATA, Path(dataset), Path(get_dataset_path(str(dataset))) / DATA):
        if (folder / "metadata.json").is_file():
            return folder
    raise ConfigurationError(f"there is no Minari dataset {dataset}: `armctl collect` writes one")


def _check_fits(name: str, metadata: Mapping[str, Any], storage: Any, worlds: EpisodeVectorEnv) -> None:
    recorded = (shapes(storage.observation_space), shapes(storage.action_space))
    here = (shapes(worlds.single_observation_space), shapes(worlds.single_action_space))
    if recorded != here:
        raise ConfigurationError(
            f"the dataset {name} has observations {recorded[0]} and actions {recorded[1]}; "
            f"here they are {here[0]} and {here[1]}"
        )
    interface = metadata.get("interface", {})
    for key, value in worlds.task.interface.items():
        if interface.get(key, value) != value:
            raise ConfigurationError(f"the dataset {name} has {key} {interface[key]!r}, but here {key} is {value!r}")


def _check_whole(name: str, episode: Demonstration, worlds: EpisodeVectorEnv) -> None:
    parts = episode.observations if isinstance(episode.observations, dict) else {"observation": episode.observations}
    spaces = worlds.single_observation_space
    expected = dict(spaces.spaces) if isinstance(spaces, gymnasium.spaces.Dict) else {"observation": spaces}
    steps = len(episode.actions)
    whole = steps > 0 and episode.actions.shape[1:] == worlds.single_action_space.shape and set(parts) == set(expected)
    if not whole or any(parts[part].shape != (steps + 1, *(space.shape or ())) for part, space in expected.items()):
        raise ConfigurationError(
            f"{name} is incomplete: it needs one observation more than actions, with the shapes of the spaces"
        )
    if not all(np.isfinite(values).all() for values in (episode.actions, *parts.values())):
        raise ConfigurationError(f"{name} has numbers that are not finite")


def _minari() -> Any:
    try:
        import h5py  # noqa: F401
        import minari.dataset.minari_storage
    except ModuleNotFoundError as error:
        raise missing_extra("a Minari dataset", error) from error
    return minari


def _spec(env: str, options: Mapping[str, Any]) -> Any:
    """The specification to make the environment again; None if an option cannot be written as JSON."""
    spec = copy.deepcopy(find_spec(env))
    given = dict(options)
    spec.max_episode_steps = given.pop("max_episode_steps", spec.max_episode_steps)
    spec.kwargs.update(given)
    try:
        spec.to_json()
    except (TypeError, ValueError):
        return None
    return spec


def _dataset_id(folder: Path) -> str:
    """The folder's name in Minari's format: letters, digits, - and _, and a version."""
    name = re.sub(r"[^-\w]", "_", folder.resolve().name)
    return name if re.search(r".-v\d+$", name) else f"{name}-v0"
