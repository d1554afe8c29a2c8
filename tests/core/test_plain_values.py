"""Values travel as JSON, and come back the same; nothing else comes back."""

import json

import numpy as np
import pytest

from armctl.core.plain_values import plain, restored

VALUES = [
    None, True, 3, 0.1, float("nan"), -float("inf"), "forwards", np.float32(0.1), np.int64(3), np.bool_(True),
    np.arange(6.0).reshape(2, 3), np.zeros((0, 3), np.float32), np.array(["a", "bc"]), np.array([1 + 2j]),
    [1, (2, [3.5])], {"a": np.ones(2), "b": {1: (True, None)}},
]  # fmt: skip


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_values_travel_as_they_are(value):
    same = restored(json.loads(json.dumps(plain(value))))
    np.testing.assert_equal(same, value)
    assert np.asarray(same).dtype == np.asarray(value).dtype if not isinstance(value, dict | list) else True
    whole = np.empty(2, dtype=object)
    whole[:] = [value, {"nested": value}]
    np.testing.assert_equal(restored(json.loads(json.dumps(plain(whole))))[0], value)


def test_other_values_travel_as_texts_and_forged_ones_are_refused():
    assert repr(restored(plain(object))) == "<class 'object'>"
    for forged in ({"dtype": "|O", "shape": [1], "data": "AAAAAAAAAAA="}, {"eval": "1"}, [1], {"list": 3}):
        with pytest.raises((ValueError, TypeError)):
            restored(forged)
