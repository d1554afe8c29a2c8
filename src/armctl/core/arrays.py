"""Arrays: a type that all packages share, and a check of arguments."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.errors import ConfigurationError

Array = NDArray[np.float64]


LARGEST = float(np.finfo(float).max)


def checked_array(name: str, value: ArrayLike, shape: tuple[int, ...], largest: float = LARGEST) -> Array:
    """Return an array of finite numbers up to `largest`; raises `ConfigurationError` for anything else."""
    try:
        array = np.ascontiguousarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty((0,) * (1 + len(shape)))
    if array.shape != shape or not (np.abs(array) <= largest).all():
        numbers = "finite numbers" if largest == LARGEST else f"numbers within +-{largest:g}"
        raise ConfigurationError(f"{name} should be an array {shape} of {numbers}, not {value!r}")
    return array
