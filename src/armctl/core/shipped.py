"""Files of arrays that come with armctl, such as layouts and problems."""

import io
import zipfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from armctl.core.errors import ConfigurationError
from armctl.core.files import bounded_bytes

T = TypeVar("T")
LARGEST = 16 * 2**20
"""Bytes of a file, and of the arrays in it, that armctl reads."""


def check_arrays(owner: Any, **expected: tuple[type[np.generic], tuple[int, ...]]) -> None:
    """Make arrays of an object read-only. Raise `ConfigurationError` for one of another type or shape than expected."""
    for name, (kind, shape) in expected.items():
        array = getattr(owner, name)
        if array.dtype != kind or array.shape != shape or not np.isfinite(array).all():
            raise ConfigurationError(f"{name} should be finite numbers {shape}, not {array.dtype} {array.shape}")
        array.setflags(write=False)


def write_shipped(owner: Any, number: int, path: Path, *, compressed: bool = True) -> None:
    """Write the fields of a dataclass to a file with the format `number`: the same bytes for the same arrays."""
    values = {field.name: getattr(owner, field.name) for field in fields(owner)}
    save = np.savez_compressed if compressed else np.savez
    save(path, allow_pickle=False, format=number, **values)


def read_shipped(path: Path, number: int, make: Callable[[dict[str, Any]], T]) -> T:
    """Return what `make` makes of the arrays in a file with the format `number`, by their names.

    Raises `ConfigurationError` if the file is missing or damaged.
    """
    try:
        content = io.BytesIO(bounded_bytes(path, LARGEST))
        with zipfile.ZipFile(content) as archive:
            if sum(member.file_size for member in archive.infolist()) > LARGEST:
                raise ValueError("its arrays are too large")
        with np.load(content, allow_pickle=False) as arrays:
            values = dict(arrays)
        if (other := values.pop("format")) != number:
            raise ValueError(f"it has format {other}, not {number}")
        return make(values)
    except Exception as error:  # what zipfile and numpy raise for damaged files is not documented
        raise ConfigurationError(f"{path} cannot be read ({error}): install armctl again") from error
