import itertools

import numpy as np
import pytest

from armctl.planning.turn_planner import TurnPlannerOptions, plan_turns
from armctl.scene import BridgeMap

EMPTY = BridgeMap(20.0, 1.4, np.zeros((0, 5)))
ACROSS = BridgeMap(20.0, 1.4, np.array([[8.0, -0.6, 0.0, 0.2, 0.8]]))
START = np.array((1.0, 0.0, 0.0))
SLOW = TurnPlannerOptions(speed=1.0, turn_rate=0.1, discomfort=0.0)


def turning(path, yaw=0.0):
    steps = np.diff(path, axis=0)
    return np.abs(np.diff(np.concatenate(((yaw,), np.arctan2(steps[:, 1], steps[:, 0]))))).sum()


def test_a_free_way_is_straight_and_takes_the_time_of_its_length():
    path, time = plan_turns(EMPTY, START, 19.0, SLOW)
    assert np.abs(path[:, 1]).max() == 0.0
    assert time == pytest.approx(18.0)


def test_it_passes_a_block_with_clearance_in_no_less_than_the_time_that_its_turns_take():
    path, time = plan_turns(ACROSS, START, 19.0, SLOW)
    dense = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(path)])
    assert ACROSS.clearance(dense).min() > SLOW.clearance - 0.02
    assert time >= max(turning(path) / SLOW.turn_rate, np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) - 1e-6


def test_slower_turns_take_longer_and_bend_less():
    slow, fast = (plan_turns(ACROSS, START, 19.0, TurnPlannerOptions(turn_rate=w)) for w in (0.05, 2.0))
    assert slow[1] > fast[1]
    assert turning(slow[0]) <= turning(fast[0]) + 1e-9


def test_it_takes_the_heading_into_account():
    _, ahead = plan_turns(EMPTY, START, 19.0, SLOW)
    _, aslant = plan_turns(EMPTY, np.array((1.0, 0.0, 0.4)), 19.0, SLOW)
    assert aslant > ahead + 0.5


@pytest.mark.parametrize(
    ("bridge", "pose"),
    [
        (BridgeMap(20.0, 1.4, np.array([[8.0, 0.0, 0.0, 0.2, 1.4]])), START),
        (EMPTY, np.array((1.0, 1.5, 0.0))),
        (EMPTY, np.array((1.0, 1.3, 0.7))),
    ],
)
def test_without_a_way_there_is_no_path(bridge, pose):
    path, time = plan_turns(bridge, pose, 19.0, SLOW)
    assert path.shape == (0, 2)
    assert time == np.inf
