"""Values as JSON, for messages from a process that is not trusted.

They are arrays, numbers and texts, and never code, which a pickle may be.
"""

import base64
from typing import Any

import numpy as np

from armctl.core.arrays import object_array

KINDS = "biufcSU"
"""Kinds of the elements of arrays: numbers and texts."""
LONGEST = 1_000
"""Characters of a text in place of a value of another kind."""


class Unrepresentable:
    """A value of another kind, of which only its text is known."""

    def __init__(self, text: str) -> None:
        self._text = text

    def __repr__(self) -> str:
        return self._text


def plain(value: Any) -> Any:
    """Return a value as JSON values from which `restored` makes the same again."""
    match value:
        case None | bool() | int() | str():
            return value
        case list() | tuple():
            return {type(value).__name__: [plain(item) for item in value]}
        case dict():
            return {"dict": [[plain(key), plain(item)] for key, item in value.items()]}
        case np.ndarray() if value.dtype == object:
            return {"objects": [plain(item) for item in value.ravel().tolist()], "shape": list(value.shape)}
        case float() | np.generic() | np.ndarray() if (array := np.asarray(value)).dtype.kind in KINDS:
            data = base64.b64encode(array.tobytes()).decode()
            return {"dtype": array.dtype.str, "shape": list(array.shape), "data": data}
    return {"text": repr(value)[:LONGEST]}


def restored(value: Any) -> Any:
    """Return the value that `plain` has made JSON values of. Raises `ValueError` for any others."""
    match value:
        case None | bool() | int() | str():
            return value
        case {"list": list(items)}:
            return [restored(item) for item in items]
        case {"tuple": list(items)}:
            return tuple(restored(item) for item in items)
        case {"dict": list(items)}:
            return {restored(key): restored(item) for key, item in items}
        case {"objects": list(items), "shape": list(shape)}:
            return object_array([restored(item) for item in items]).reshape(shape)
        case {"dtype": str(name), "shape": list(shape), "data": str(data)} if np.dtype(name).kind in KINDS:
            array = np.frombuffer(base64.b64decode(data), name).reshape(shape).copy()
            return array if shape else array[()]
        case {"text": str(text)}:
            return Unrepresentable(text)
    raise ValueError("a message is none of armctl's")
