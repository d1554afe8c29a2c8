"""The files of a Minari dataset.

Minari (Younis et al. 2024) is Gymnasium's format for offline data: a folder with an HDF5 file and a JSON file. It may
come from a stranger: reading it unpickles nothing, makes no environment from it, and follows no link in it. What armctl
writes has checksums, so that damage is noticed before libhdf5, which a corrupt file can crash, sees it.
"""

import copy
import json
import os
import re
import reprlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium

from armctl.agents import shapes
from armctl.core.errors import ConfigurationError, missing_extra, reason
from armctl.core.files import CHECKSUM, bounded_text, file_checksum, sealed, unsealed, write_atomically
from armctl.datasets.demonstrations import Demonstration
from armctl.envs import EpisodeVectorEnv, find_spec

DATA = "data"
"""Minari's folder within the dataset's folder."""
PARTS: tuple[str, ...] = (DATA,)
"""The folders within the dataset's folder of which it consists."""
UNFINISHED = "unfinished"
"""The folder within the dataset's folder that keeps the finished episodes of an interrupted collection."""
METADATA = "metadata.json"
MANIFEST = f"{DATA}/{METADATA}"
"""File within the dataset's folder that has its identity."""
SHA256 = "sha256"
"""The metadata's entry with the HDF5 file's checksum."""


def write_dataset(
    folder: Path, episodes: Iterable[tuple[Demonstration, Mapping[str, Any]]], metadata: Mapping[str, Any]
) -> None:
    """Write `PARTS` to a folder: episodes with their attributes, and metadata. Raises `OSError`."""
    from armctl.datasets import hdf5

    (folder / DATA).mkdir(parents=True)
    file = folder / DATA / hdf5.FILE
    hdf5.write_episodes(file, episodes)
    about = {**metadata, "dataset_size": round(file.stat().st_size / 1e6, 1), SHA256: file_checksum(file)}
    write_atomically(folder / MANIFEST, sealed(about))


def describe(folder: Path, env: str, env_options: Mapping[str, Any], worlds: EpisodeVectorEnv) -> dict[str, Any]:
    """Return the metadata that Minari and `read_demonstrations` need, as JSON values, for a dataset in this folder."""
    from minari.serialization import serialize_space

    described = {
        "data_format": "hdf5",
        "jpeg_encoding": False,  # it is lossy
        "observation_space": serialize_space(worlds.single_observation_space),
        "action_space": serialize_space(worlds.single_action_space),
        "dataset_id": _dataset_id(folder),
        "minari_version": require_minari().__version__,
        "env": env,
        "env_options": {option: str(value) for option, value in env_options.items()},
        "interface": worlds.task.interface,
    }
    spec = _spec(env, env_options)
    return described if spec is None else {**described, "env_spec": spec.to_json()}


def check_recordable(worlds: EpisodeVectorEnv) -> None:
    """Raise `ConfigurationError` unless observations and actions are numbers in arrays, or in a Dict of arrays."""
    arrays = (
        gymnasium.spaces.Box, gymnasium.spaces.Discrete, gymnasium.spaces.MultiBinary, gymnasium.spaces.MultiDiscrete
    )  # fmt: skip
    whole = worlds.single_observation_space
    parts = list(whole.spaces.values()) if isinstance(whole, gymnasium.spaces.Dict) else [whole]
    for space in (worlds.single_action_space, *parts):
        if not isinstance(space, arrays):
            raise ConfigurationError(
                f"a dataset cannot hold what is in the space {space}: observations and actions should be arrays of "
                "numbers, or observations a Dict of such"
            )


def read_demonstrations(dataset: str | Path, worlds: EpisodeVectorEnv) -> list[Demonstration]:
    """All episodes of a Minari dataset, given by its folder, or by its id in Minari's own folder.

    Episodes without an entry `success` in their metadata count as successes. Raises `ConfigurationError` for a dataset
    that is missing or corrupt, has values elsewhere than in its own HDF5 file, or more than fit into memory, and for
    one whose observations and actions are not those of `worlds`.
    """
    try:
        import h5py  # noqa: F401
    except ModuleNotFoundError as error:
        raise missing_extra("a Minari dataset", error) from error
    from armctl.datasets import hdf5

    folder = _find(dataset)
    try:
        metadata = _read_metadata(folder)
        _check_fits(metadata, worlds)
        if SHA256 in metadata and metadata[SHA256] != file_checksum(folder / hdf5.FILE, hdf5.LARGEST_FILE):
            raise ConfigurationError(
                f"its {hdf5.FILE} is damaged, or was changed: it does not have the checksum in {METADATA}. If you "
                f"changed it, delete the entries {SHA256} and {CHECKSUM} there"
            )
        spaces = worlds.single_observation_space, worlds.single_action_space
        episodes = list(hdf5.read_episodes(folder / hdf5.FILE, metadata["total_episodes"], *spaces))
    except ConfigurationError as error:
        raise ConfigurationError(f"the dataset {dataset} cannot be used: {error}") from error
    except Exception as error:  # h5py and json raise many kinds of exceptions for broken files
        raise ConfigurationError(
            f"{dataset} is not a readable Minari dataset: {type(error).__name__}: {error}"
        ) from error
    if not episodes:
        raise ConfigurationError(f"the dataset {dataset} has no episodes")
    return episodes


def _find(dataset: str | Path) -> Path:
    home = Path(os.environ.get("MINARI_DATASETS_PATH") or Path.home() / ".minari" / "datasets")
    try:
        for folder in (Path(dataset) / DATA, Path(dataset), home / dataset / DATA):
            if (folder / METADATA).is_file():
                return folder
        unfinished = (Path(dataset) / UNFINISHED).is_dir()
    except (OSError, ValueError):
        unfinished = False  # a name that no folder can have
    how = "the `armctl collect` that began it resumes" if unfinished else "`armctl collect` writes one"
    raise ConfigurationError(f"there is no Minari dataset {dataset}: {how}")


def policy_of(dataset: str | Path) -> str:
    """Return the name of a Minari dataset's policy, or else of the dataset. Raises `ConfigurationError`."""
    try:
        return str(_read_metadata(_find(dataset)).get("algorithm_name") or dataset)
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"the dataset {dataset} cannot be used: {reason(error)}") from error


def _read_metadata(folder: Path) -> dict[str, Any]:
    text = bounded_text(folder / METADATA)
    metadata = json.loads(text)
    if isinstance(metadata, dict) and CHECKSUM in metadata:
        try:
            return unsealed(text)
        except ValueError as error:
            raise ConfigurationError(
                f"its {METADATA} is damaged, or was changed. If you changed it, delete the entry {CHECKSUM} there"
            ) from error
    if not isinstance(metadata, dict) or not {"observation_space", "action_space"} <= set(metadata):
        raise ConfigurationError("it does not declare its observation and action spaces")
    return metadata


def _check_fits(metadata: Mapping[str, Any], worlds: EpisodeVectorEnv) -> None:
    if (data_format := metadata.get("data_format", "hdf5")) != "hdf5":
        raise ConfigurationError(f"its format is {_short(data_format)}, and armctl reads hdf5 only")
    recorded = tuple(_declared_shapes(json.loads(metadata[f"{part}_space"])) for part in ("observation", "action"))
    expected = (shapes(worlds.single_observation_space), shapes(worlds.single_action_space))
    if recorded != expected:
        raise ConfigurationError(
            f"it has observations {_short(recorded[0])} and actions {_short(recorded[1])}; "
            f"here they are {expected[0]} and {expected[1]}"
        )
    interface = metadata.get("interface", {})
    for key, value in worlds.task.interface.items():
        if (stored_value := interface.get(key, value)) != value:
            raise ConfigurationError(f"it has {key} {_short(stored_value)}, but here {key} is {value!r}")


def _declared_shapes(space: Mapping[str, Any]) -> Any:
    """Shape of a space that a dataset declares, in the format of `shapes`; the space itself could be of any size."""
    match space["type"]:
        case "Dict":
            return {name: _declared_shapes(part) for name, part in space["subspaces"].items()}
        case "Discrete":
            return []
        case "MultiDiscrete":
            return [len(space["nvec"])]
        case "MultiBinary":
            return [space["n"]] if isinstance(space["n"], int) else list(space["n"])
        case _:
            return list(space["shape"])


def _short(value: Any) -> str:
    """Return a value from a file as messages show it."""
    return reprlib.repr(value)


def library_versions() -> dict[str, str]:
    """Versions of what writes the dataset; raises `ConfigurationError` if it is not installed."""
    return {"minari": require_minari().__version__}


def require_minari() -> ModuleType:
    """Minari; raises `ConfigurationError` if it, or what it needs, is not installed."""
    try:
        import h5py  # noqa: F401
        import minari
    except ModuleNotFoundError as error:
        raise missing_extra("a Minari dataset", error) from error
    return minari  # type: ignore[no-any-return]


def _spec(env: str, options: Mapping[str, Any]) -> Any:
    """Return the specification to make the environment again; None if an option cannot be written as JSON."""
    spec = copy.deepcopy(find_spec(env))
    remaining_options = dict(options)
    spec.max_episode_steps = remaining_options.pop("max_episode_steps", spec.max_episode_steps)
    spec.kwargs.update(remaining_options)
    try:
        spec.to_json()
    except (TypeError, ValueError):
        return None
    return spec


def _dataset_id(folder: Path) -> str:
    """Return the folder's name in Minari's format: letters, digits, - and _, and a version."""
    name = re.sub(r"[^-\w]", "_", os.path.basename(os.path.realpath(folder)))
    return name if re.search(r".-v\d+$", name) else f"{name}-v0"
