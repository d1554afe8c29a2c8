"""Messages survive the way there and back, and bytes that are none are told."""

import contextlib

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from armctl.core.errors import ConfigurationError
from armctl.remote.messages import UnreadableMessage, packed, unpacked
from armctl.remote.names import is_remote, other_python

PAIR = np.array([1, 2], np.float32)
NUMBERS = hnp.arrays(
    st.sampled_from([np.float32, np.float64, np.int32, np.uint8, np.bool_]), hnp.array_shapes(min_dims=0, max_side=4)
)


@given(st.dictionaries(st.text(max_size=5), st.one_of(NUMBERS, st.text(), st.integers(-(2**60), 2**60), st.none())))
def test_a_message_comes_back_as_it_was(message):
    back = unpacked(packed(message))
    assert list(back) == list(message)
    for name, value in message.items():
        if isinstance(value, np.ndarray):
            assert back[name].dtype == value.dtype
            np.testing.assert_array_equal(back[name], value)
        else:
            assert back[name] == value


@given(st.binary(max_size=60))
def test_bytes_that_are_no_message_are_told(content):
    with contextlib.suppress(UnreadableMessage):
        assert isinstance(unpacked(content), dict)


@pytest.mark.parametrize(
    "array",
    [
        {b"dtype": "|O", b"data": b"12345678", b"shape": [1]},
        {b"dtype": "<f8", b"data": b"1234567", b"shape": [1]},
        {b"dtype": "<f8", b"data": b"", b"shape": [2**40]},
        {b"dtype": "nonsense", b"data": b"", b"shape": []},
        {b"data": b""},
    ],
)
def test_arrays_that_are_none_are_told(array):
    with pytest.raises(UnreadableMessage):
        unpacked(msgpack.packb({"actions": {b"__ndarray__": True} | array}))


def test_arrays_are_written_as_openpi_writes_them():
    """`openpi_client.msgpack_numpy`, version 0.1.2."""
    expected = {b"__ndarray__": True, b"data": PAIR.tobytes(), b"dtype": "<f4", b"shape": [2]}
    assert msgpack.unpackb(packed({"x": PAIR}))["x"] == expected


def test_objects_are_not_sent():
    with pytest.raises(TypeError, match="no object"):
        packed({"x": object()})
    with pytest.raises(TypeError, match="no ndarray"):
        packed({"x": np.array([object()])})


def test_names():
    assert all(map(is_remote, ("ws://127.0.0.1:8000", "wss://host", "python=venv/bin/python:mine.py:go")))
    assert not any(map(is_remote, ("reach_ik", "mine.py:go", None, 3)))
    assert other_python("python=venv/bin/python:a/mine.py:go") == ("venv/bin/python", "a/mine.py", "go")
    for name in ("python=venv/bin/python", "python=:mine:go", "python=python:mine:"):
        with pytest.raises(ConfigurationError, match="python=INTERPRETER:MODULE:NAME"):
            other_python(name)
