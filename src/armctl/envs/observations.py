"""Helpers for observations and actions of n worlds, and of one of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array, Observations, map_arrays, object_array
from armctl.core.errors import InvalidAction


def one_of(observations: Observations, world: int) -> Any:
    """Return the observation of one world."""
    if isinstance(observations, np.ndarray):
        return observations[world]
    return map_arrays(lambda values: values[world], observations)


def stacked(observations: Sequence[Any]) -> Observations:
    """Return observations of n worlds as a batch. Values without a common shape become an array of objects, (n,)."""
    first = observations[0]
    if isinstance(first, dict):
        return {name: stacked([observation[name] for observation in observations]) for name in first}  # type: ignore[misc]
    if isinstance(first, (np.ndarray, np.generic, int, float)) and len(set(map(np.shape, observations))) == 1:
        return np.stack(observations)
    return object_array(observations)


def with_replaced(observations: Observations, ids: NDArray[np.int32], new: Observations) -> Observations:
    """Return observations in which those of worlds `ids` are replaced by new ones."""

    def replaced(values: NDArray[Any], rows: NDArray[Any]) -> NDArray[Any]:
        values = values.copy()
        values[ids] = rows
        return values

    replaced_observations: Observations = map_arrays(replaced, observations, new)
    return replaced_observations


def batch_of_one(observation: Any) -> Observations:
    """Return one world's observation as a batch."""
    batch: Observations = map_arrays(lambda value: np.asarray(value)[None], observation)
    return batch


def action_numbers(actions: ArrayLike) -> Array:
    """Return actions as an array of floats. Raises `InvalidAction`."""
    try:
        return np.array(actions, dtype=float)
    except (TypeError, ValueError) as error:
        raise InvalidAction(f"an action is an array of numbers, not {actions!r}") from error
