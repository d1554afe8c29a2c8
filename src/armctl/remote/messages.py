"""Messages between processes: maps of numbers, texts and arrays, in the encoding of openpi's policy servers.

A message is a map in msgpack, in which an array is a map of its bytes, dtype and shape, and never code. This module
imports nothing else of armctl: Pythons that have no armctl use it, too.
"""

from typing import Any

import msgpack
import numpy as np

LARGEST = 2**28
"""Bytes of a message."""
VERSION = 1
"""Version of the messages that armctl's two ends exchange beyond openpi's protocol."""
KINDS = "biuf"
"""Kinds of an array's numbers."""
ARRAY, SCALAR = b"__ndarray__", b"__npgeneric__"


class UnreadableMessage(ValueError):
    """Bytes that are no message of this protocol."""


def packed(message: dict[str, Any]) -> bytes:
    """Return a message as bytes. Raises `TypeError` for values of other kinds."""
    return bytes(msgpack.packb(message, default=_packable))


def unpacked(content: bytes | str) -> dict[str, Any]:
    """Return the message of which these are the bytes. Raises `UnreadableMessage`."""
    if isinstance(content, str):
        raise UnreadableMessage(f"a text in place of a message: {content[-500:]}")
    try:
        message = msgpack.unpackb(content, object_hook=_restored)
    except Exception as error:  # msgpack has errors of its own, and NumPy raises many kinds
        raise UnreadableMessage(f"bytes that are no message ({type(error).__name__}: {error})") from error
    if not isinstance(message, dict):
        raise UnreadableMessage(f"a {type(message).__name__} in place of a map")
    return message


def _packable(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind in KINDS:
        facts = {b"dtype": value.dtype.str}
        if isinstance(value, np.generic):
            return facts | {SCALAR: True, b"data": value.item()}
        return facts | {ARRAY: True, b"data": value.tobytes(), b"shape": value.shape}
    raise TypeError(f"a message holds numbers, texts and arrays of numbers, and no {type(value).__name__}")


def _restored(value: dict[Any, Any]) -> Any:
    if ARRAY not in value and SCALAR not in value:
        return value
    dtype = np.dtype(value[b"dtype"])
    if dtype.kind not in KINDS:
        raise ValueError(f"an array of {dtype}")
    if SCALAR in value:
        return dtype.type(value[b"data"])
    return np.frombuffer(value[b"data"], dtype).reshape(value[b"shape"]).copy()
