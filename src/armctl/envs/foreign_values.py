"""Checks of what environments of others return: values of any kind come in here, and armctl's own types go on.

Each function takes the value and its name in a message, and raises `EnvironmentFailed` for what it cannot use.
"""

import copy
import math
from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from armctl.core.errors import EnvironmentFailed, defined_at

STEP = ("observation", "reward", "terminated", "truncated", "info")
RESET = ("observation", "info")


def parts(value: Any, names: tuple[str, ...], method: str, env: Any) -> tuple[Any, ...]:
    """Return what a method of an environment has returned, as so many parts; the last one is `info`, a mapping."""
    if not isinstance(value, tuple) or len(value) != len(names):
        actual = f"{len(value)} values" if isinstance(value, tuple) else f"a {type(value).__name__}"
        raise EnvironmentFailed(
            f"{type(env).__name__}.{method} returned {actual}, not {len(names)}: {', '.join(names)}{defined_at(env)}"
        )
    if not isinstance(value[-1], Mapping):
        raise EnvironmentFailed(f"info is {_quoted(value[-1])}, not a dict{defined_at(env)}")
    return value


def number(value: Any, name: str) -> float:
    """Return a real number, or the one number of an array."""
    element = _single(value)
    try:
        if not isinstance(element, (str, bytes, np.complexfloating)):
            return float(element)
    except (TypeError, ValueError, OverflowError):
        pass
    raise EnvironmentFailed(f"{name} is {_quoted(value)}, not a number")


def flag(value: Any, name: str) -> bool:
    """Return whether a value is true: a bool, 0 or 1, or an array of one of these."""
    is_true = truth(value)
    if is_true is None:
        raise EnvironmentFailed(f"{name} is {_quoted(value)}, neither true nor false")
    return is_true


def truth(value: Any) -> bool | None:
    """Return a bool, 0, 1, or the one of an array; None for anything else."""
    element = _single(value)
    is_one_or_zero = isinstance(element, (Real, np.bool_)) and element in (0, 1)
    return bool(element) if is_one_or_zero else None


def reward_terms(info: Mapping[str, Any]) -> dict[str, float]:
    """Return the rewards of a step by term, if the environment says so as armctl's own do."""
    terms = info.get("reward_terms", {})
    if not isinstance(terms, Mapping):
        return {}
    values = {str(name): number(value, f"the reward term {name}") for name, value in terms.items()}
    for name, value in values.items():
        if not math.isfinite(value):
            raise EnvironmentFailed(f"the reward term {name} is {value}")
    return values


def observation(value: Any, space: spaces.Space[Any], name: str = "its observation") -> Any:
    """Return a copy of an observation whose structure is that of its space: shapes are not compared.

    Raises `EnvironmentFailed` for parts that lack, and for texts and objects where the space has numbers.
    """
    if isinstance(space, spaces.Dict):
        if not isinstance(value, Mapping) or set(value) != set(space.spaces):
            raise EnvironmentFailed(f"{name} is {_quoted(value)}, not a dict of {', '.join(space.spaces)}")
        return {key: observation(value[key], part, f"{name}[{key!r}]") for key, part in space.spaces.items()}
    if isinstance(space, spaces.Tuple):
        if not isinstance(value, tuple) or len(value) != len(space.spaces):
            raise EnvironmentFailed(f"{name} is {_quoted(value)}, not a tuple of {len(space.spaces)}")
        return tuple(
            observation(part, inner, f"{name}[{i}]")
            for i, (part, inner) in enumerate(zip(value, space.spaces, strict=True))
        )
    if isinstance(space, (spaces.Box, spaces.MultiDiscrete, spaces.MultiBinary, spaces.Discrete)):
        array = np.array(value)
        if array.dtype.kind not in "biuf":
            raise EnvironmentFailed(f"{name} is {_quoted(value)}, and its space has numbers, {space}")
        return array
    return copy.deepcopy(value)


def is_finite(value: Any) -> bool:
    """Return whether all numbers of an `observation` are finite."""
    if isinstance(value, (Mapping, tuple)):
        return all(map(is_finite, value.values() if isinstance(value, Mapping) else value))
    return not isinstance(value, np.ndarray) or value.dtype.kind != "f" or bool(np.isfinite(value).all())


def picture(value: Any, env: Any) -> NDArray[np.uint8]:
    """Return a picture (height, width, 3) of an environment: a channel for transparency is left out."""
    array: NDArray[Any] = value if isinstance(value, np.ndarray) else np.empty(0)
    if array.dtype != np.uint8 or array.ndim != 3 or array.shape[-1] not in (3, 4) or 0 in array.shape:
        actual = f"an array {value.shape} of {value.dtype}" if isinstance(value, np.ndarray) else _quoted(value)
        raise EnvironmentFailed(
            f"{type(env).__name__}.render returned {actual}, not an array (height, width, 3) of uint8{defined_at(env)}"
        )
    rgb: NDArray[np.uint8] = array[:, :, :3]
    return rgb


def _single(value: Any) -> Any:
    """Return the one element of an array, and anything else as it is."""
    if isinstance(value, (str, bytes, Mapping)) or value is None:
        return value
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, RuntimeError):
        return value
    return array.reshape(-1)[0] if array.size == 1 and array.dtype != object else value


def _quoted(value: Any) -> str:
    text = f"a {type(value).__name__}" if isinstance(value, list) else " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:77]}..."
