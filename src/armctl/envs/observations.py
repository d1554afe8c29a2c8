"""Helpers for observations and actions of n worlds, and of one of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import InvalidAction
from armctl.tasks import Observations


def one_of(observations: Observations, world: int) -> Any:
    """Return the observation of one world."""
    if isinstance(observations, dict):
        return {name: values[world] for name, values in observations.items()}
    return observations[world]


def stacked(observations: Sequence[Any]) -> Observations:
    """Return observations of n worlds as a batch. Values without a common shape become an array of objects, (n,)."""
    first = observations[0]
    if isinstance(first, dict):
        return {name: stacked([observation[name] for observation in observations]) for name in first}  # type: ignore[misc]
    if isinstance(first, (np.ndarray, np.generic, int, float)):
        return np.stack(observations)
    batch = np.empty(len(observations), dtype=object)
    batch[:] = observations
    return batch


def with_replaced(observations: Observations, ids: NDArray[np.int32], new: Observations) -> Observations:
    """Return observations in which those of worlds `ids` are replaced by new ones."""
    if isinstance(observations, dict):
        assert isinstance(new, dict)
        return {name: _replaced_rows(values, ids, new[name]) for name, values in observations.items()}
    assert isinstance(new, np.ndarray)
    return _replaced_rows(observations, ids, new)


def _replaced_rows(values: NDArray[Any], ids: NDArray[np.int32], new: NDArray[Any]) -> NDArray[Any]:
    values = values.copy()
    values[ids] = new
    return values


def batch_of_one(observation: Any) -> Observations:
    """Return one world's observation as a batch."""
    if isinstance(observation, dict):
        return {name: np.asarray(value)[None] for name, value in observation.items()}
    return np.asarray(observation)[None]


def action_numbers(actions: ArrayLike) -> Array:
    """Return actions as an array of floats. Raises `InvalidAction`."""
    try:
        return np.array(actions, dtype=float)
    except (TypeError, ValueError) as error:
        raise InvalidAction(f"an action is an array of numbers, not {actions!r}") from error
