"""Arrays: a type that all packages share, a check of arguments, and observations of one array or several by name."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.errors import ConfigurationError

Array = NDArray[np.float64]
Observations = NDArray[np.float32] | dict[str, NDArray[Any]]
"""Observations of n worlds, (n, ...): one array, or several by name."""
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


def map_arrays(function: Callable[..., Any], observations: Any, *others: Any) -> Any:
    """Return a function's values for observations, and others like them: of the one array, or of each by its name.

    Names may be nested.
    """
    if isinstance(observations, dict):
        return {
            name: map_arrays(function, values, *(other[name] for other in others))
            for name, values in observations.items()
        }
    return function(observations, *others)


def object_array(values: Sequence[Any]) -> NDArray[Any]:
    """Return values of any kind as an array of objects, (n,)."""
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array
