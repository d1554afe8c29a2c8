import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armctl.core.errors import ConfigurationError
from armctl.core.search_space import Range, search_space, value_at, with_values

FILE = {"options": {"gamma": 0.97, "units": 128, "inner": {"horizon": 20}}, "scale": 1.0, "learner": "ppo"}


def test_a_table_mirrors_the_file():
    table = {
        "scale": {"low": 0.5, "high": 2},
        "options": {"units": {"choices": [64, 128]}, "inner": {"horizon": {"low": 5, "high": 30}}},
    }
    space = search_space(table, FILE, "it")
    assert {*space} == {"scale", "options.units", "options.inner.horizon"}
    assert space["options.inner.horizon"].is_whole
    assert not space["scale"].is_whole


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"options": {"gamma": {"low": 0.9}}}, "options.gamma: a range has low and high, or choices"),
        ({"options": {"gamma": {"low": 0.99, "high": 0.9}}}, "low must be less than high"),
        ({"options": {"gamma": {"low": 0.0, "high": 1.0, "log": True}}}, "low must be more than 0"),
        ({"options": {"gamma": {"low": 0.9, "high": math.inf}}}, "both finite"),
        ({"options": {"gamma": {"low": 0.9, "high": 0.99, "choices": [1]}}}, "either choices, or low and high"),
        ({"options": {"gamma": {"choices": [0.97]}}}, "at least two"),
        ({"options": {"gamma": {"choices": [0.97, 0.97]}}}, "differ"),
        ({"options": {"gamma": {"low": 0.9, "high": 0.99, "step": 2}}}, "Extra inputs"),
        ({"options": {"gamma": 0.9}}, "options.gamma"),
        ({"options": {"gama": {"low": 0.9, "high": 0.99}}}, "does not say which value options.gama has now"),
        ({"options": {"gamma": {"inner": {"low": 0.9, "high": 0.99}}}}, "options.gamma.inner"),
        ({"options": {"gamma": {"low": 0.1, "high": 0.9}}}, "present value of options.gamma, 0.97, is not in"),
        ({"options": {"units": {"low": 1.5, "high": 500}, "gamma": {"low": 0, "high": 1}}}, "options.gamma, 0.97"),
        ({"learner": {"choices": ["sac", "bc"]}}, "present value of learner, 'ppo'"),
    ],
)
def test_what_is_no_search_space_is_refused(table, message):
    with pytest.raises(ConfigurationError, match=message):
        search_space(table, FILE, "it")


@given(value=st.integers(5, 30))
def test_values_are_put_where_they_belong_and_nowhere_else(value):
    changed = with_values(FILE, {"options.inner.horizon": value, "scale": 3.0})
    assert value_at(changed, "options.inner.horizon") == value
    assert value_at(FILE, "options.inner.horizon") == 20
    back = with_values(changed, {"options.inner.horizon": 20, "scale": 1.0})
    assert back == FILE


def test_whole_numbers_and_choices_are_taken_strictly():
    assert 7 in Range(low=5, high=30)
    assert 7.5 not in Range(low=5, high=30)
    assert 7 in Range(low=5.0, high=30.0)
    assert True not in Range(low=0, high=2)
    assert True not in Range(choices=(0, 1))
    assert "1" not in Range(choices=(0, 1))
