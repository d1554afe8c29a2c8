"""The distance of failure along a line: its interval holds whatever falls, and contains the estimate."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit

from armctl.stats.failure_line import SCALES, failure_distance, line_through

FALLING = {
    "gentle": (lambda x: expit(4 - 4 * x), 1.0),
    "a step": (lambda x: np.where(x < 0.95, 1.0, 0.0), 0.95),
    "a step between the last points": (lambda x: np.where(x < 1.4, 0.99, 0.1), 1.4),
    "half everywhere": (lambda x: np.full_like(x, 0.5), 0.0),
    "a plateau above half": (lambda x: np.where(x < 1.2, 0.55, 0.45), 1.2),
    "fails undisturbed": (lambda x: np.full_like(x, 0.01), 0.0),
    "never fails": (lambda x: np.full_like(x, 0.97), math.inf),
}
"""Success by distance, and the distance from which on it is at most one half."""


@pytest.mark.parametrize("name", FALLING)
@pytest.mark.parametrize("episodes", [20, 100])
def test_the_interval_holds_in_95_percent_whatever_the_curve(name, episodes, sized):
    curve, truth = FALLING[name]
    rng, count = np.random.default_rng(5), sized(300, 5000)
    distances = np.array(SCALES)
    wins = rng.binomial(episodes, curve(distances), (count, len(distances)))
    holding = 0
    for won in wins:
        found = failure_distance(distances, won, [episodes] * len(distances))
        holding += found.low <= truth <= found.high
    assert holding >= (0.95 - 3 * math.sqrt(0.05 * 0.95 / count)) * count


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(1, 30)), min_size=1, max_size=8))
def test_the_estimate_is_within_its_interval(counts):
    distances = 0.2 * (1 + np.arange(len(counts)))
    won, played = [min(won, played) for won, played in counts], [played for _, played in counts]
    distance = failure_distance(distances, won, played)
    assert 0 <= distance.low <= distance.value <= distance.high


def test_the_estimate_is_where_success_falls_to_one_half():
    assert failure_distance([1.0, 2.0], [8, 2], [10, 10]).value == pytest.approx(1.5)
    assert failure_distance([1.0, 2.0], [8, 6], [10, 10]).value == math.inf
    assert failure_distance([1.0], [0], [10]).value == pytest.approx(0.5)
    assert failure_distance([0.0], [0], [10]).value == 0


def test_a_line_ends_at_the_box_and_has_each_point_once():
    points = line_through(np.array([0.8, 0.2]))
    assert points.max() == 1
    assert (np.diff(points, axis=0).sum(axis=1) > 0).all()
    assert len(line_through(np.ones(2))) == SCALES.index(1.0) + 1
    assert line_through(np.zeros(2)).tolist() == [[0.0, 0.0]]
