"""Episodes in the HDF5 file of a Minari dataset: written so that a full disk is an error, read with suspicion.

libhdf5 crashes when it cannot write, and an HDF5 file can name other files as the place of its values. So a write never
fails in front of libhdf5, and only arrays that lie within the file are read, after their claims have been checked.
"""

import io
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import h5py
import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError
from armctl.datasets.demonstrations import Demonstration, parts_of

FILE = "main_data.hdf5"
LARGEST = 1e12
"""Largest number in a dataset: its square is still one in single precision, in which networks compute."""
LARGEST_FILE = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2
"""Bytes of a dataset that is read as a whole: half of this machine's memory."""


def write_episodes(path: Path, episodes: Iterable[tuple[Demonstration, Mapping[str, Any]]]) -> None:
    """Write episodes, each with its attributes, as Minari does. Raises `OSError`."""
    with path.open("xb+", buffering=0) as file:
        target = _Unfailing(file)
        try:
            with h5py.File(target, "w", track_order=True) as hdf5:
                for i, (episode, attributes) in enumerate(episodes):
                    _write_episode(hdf5.create_group(f"episode_{i}"), i, episode, attributes)
                    target.check()
        finally:
            target.check()  # before what libhdf5 makes of it
        os.fsync(file.fileno())


def _write_episode(group: Any, i: int, episode: Demonstration, attributes: Mapping[str, Any]) -> None:
    group.attrs.update({"id": i, "total_steps": len(episode), **attributes})
    group.create_group("infos")
    is_last = np.arange(len(episode)) == len(episode) - 1
    arrays = {
        "actions": episode.actions,
        "rewards": episode.rewards,
        "terminations": is_last & episode.terminated,
        "truncations": is_last & (not episode.terminated),
    }
    for name, values in (parts_of(episode.observations) | arrays).items():
        group.create_dataset(name, data=values, chunks=True, maxshape=(None, *values.shape[1:]))


class _Unfailing:
    """A file whose writes seem to succeed: after the first error, which `check` raises, they do nothing."""

    def __init__(self, file: io.FileIO) -> None:
        self._file = file
        self._error: OSError | None = None
        self.seek, self.tell, self.readinto = file.seek, file.tell, file.readinto
        self.read = file.read  # by which h5py knows a file

    def write(self, content: Any) -> int:
        remaining = memoryview(content).cast("B")
        size = len(remaining)
        while self._error is None and remaining:
            try:
                remaining = remaining[self._file.write(remaining) :]
            except OSError as error:
                self._error = error
        return size

    def truncate(self, size: int) -> int:
        if self._error is None:
            try:
                self._file.truncate(size)
            except OSError as error:
                self._error = error
        return size

    def flush(self) -> None:
        """Nothing is buffered."""

    def check(self) -> None:
        if self._error is not None:
            raise self._error


def read_episodes(
    path: Path, count: int, observations: gymnasium.Space[Any], actions: gymnasium.Space[Any]
) -> Iterator[Demonstration]:
    """Episodes 0 to `count` - 1 of a file, with observations and actions in these spaces.

    Raises `ConfigurationError` for values elsewhere than in the file, of another type or shape, not finite or too
    large, and for a claim to more of them than the file and this machine's memory can hold; and whatever h5py raises
    for a file that is corrupt.
    """
    if not path.is_file():
        raise ConfigurationError(f"there is no file {path}")
    with h5py.File(path, "r") as file:
        reader = _Reader(path)
        for i in range(count):
            name = f"episode_{i}"
            yield reader.episode(_child(file, name, h5py.Group, name), name, observations, actions)


_REWARD = gymnasium.spaces.Box(-np.inf, np.inf, (), np.float64)
_FLAG = gymnasium.spaces.Discrete(2)


class _Reader:
    """Reads arrays, as long as they fit into the file and into memory."""

    def __init__(self, path: Path) -> None:
        self._bytes_left = min(path.stat().st_size, LARGEST_FILE)

    def episode(
        self, group: Any, name: str, observations: gymnasium.Space[Any], actions: gymnasium.Space[Any]
    ) -> Demonstration:
        action_array = self.array(group, "actions", actions, None, name)
        steps = len(action_array)
        if isinstance(observations, gymnasium.spaces.Dict):
            parts = _child(group, "observations", h5py.Group, name)
            observation_arrays: Any = {
                part: self.array(parts, part, space, steps + 1, name) for part, space in observations.spaces.items()
            }
        else:
            observation_arrays = self.array(group, "observations", observations, steps + 1, name)
        rewards = self.array(group, "rewards", _REWARD, steps, name)
        terminations = self.array(group, "terminations", _FLAG, steps, name)
        return Demonstration(
            observation_arrays, action_array, rewards.astype(float), bool(terminations.any()), _success(group, name)
        )

    def array(self, group: Any, name: str, space: gymnasium.Space[Any], length: int | None, label: str) -> NDArray[Any]:
        """That many values of a space, or any number of them if `length` is None."""
        *folders, last = name.split("/")
        for folder in folders:
            group = _child(group, folder, h5py.Group, label)
        dataset = _child(group, last, h5py.Dataset, label)
        label = f"{name} of {label}"
        if dataset.is_virtual or dataset.external:
            raise ConfigurationError(f"{label} lies in another file: armctl reads values only from the dataset's own")
        if dataset.id.get_create_plist().get_nfilters():
            raise ConfigurationError(f"{label} is compressed or filtered, which armctl does not read, nor Minari write")
        if dataset.dtype.kind not in "biuf" or not np.can_cast(dataset.dtype, np.dtype(space.dtype), "same_kind"):
            raise ConfigurationError(f"{label} has values of type {dataset.dtype}, not {space.dtype}")
        shape: tuple[int, ...] = dataset.shape or ()
        if length is None and shape:
            length = shape[0]
        expected = (length, *(space.shape or ()))
        if shape != expected or not length:
            raise ConfigurationError(
                f"{label} is incomplete: its shape is {shape}, and should be {expected}, with one observation "
                "more than actions"
            )
        size = int(np.prod(shape, dtype=object)) * dataset.dtype.itemsize
        self._bytes_left -= size
        if self._bytes_left < 0 or dataset.id.get_storage_size() < size:
            raise ConfigurationError(
                f"{label} claims {size:,} bytes, more than the file or this machine's memory holds"
            )
        values = np.asarray(dataset[()])
        if dataset.dtype.kind == "f" and not (np.abs(values) <= LARGEST).all():
            raise ConfigurationError(f"{label} has numbers that are not finite, or beyond {LARGEST:g}")
        return values


def _child(group: Any, name: str, kind: type, label: str) -> Any:
    """Return a group's member of that name and kind; links are refused."""
    link = group.get(name, getlink=True)
    if link is None:
        raise ConfigurationError(f"{label} has no {name}")
    if not isinstance(link, h5py.HardLink):
        raise ConfigurationError(f"{name} of {label} is a link, which armctl does not follow")
    child = group[name]
    if not isinstance(child, kind):
        raise ConfigurationError(f"{name} of {label} is not a {kind.__name__.lower()}")
    return child


def _success(group: Any, label: str) -> bool:
    """Return whether an episode was a success; without an entry, it was."""
    if "success" not in group.attrs:
        return True
    attribute = group.attrs.get_id("success")
    if attribute.shape != () or attribute.dtype.kind not in "biuf":
        raise ConfigurationError(f"success of {label} is neither true nor false")
    return bool(group.attrs["success"])
