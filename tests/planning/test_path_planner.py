import numpy as np
import pytest
import shapely

from armctl.errors import ConfigurationError
from armctl.planning import BridgeMap, PathPlannerOptions, plan_path
from armctl.tasks.bridge_layout import draw_layout

from .test_bridge_map import HALF_WIDTH, LENGTH, shapes

START, GOAL_X = (1.0, 0.0), 19.0


def layouts(count, seed=0):
    rng = np.random.default_rng(seed)
    drawn = [draw_layout(rng, LENGTH, 4.0, *((7, 0) if i % 2 else (3, 3)), 1) for i in range(count)]
    return [layout.map.with_lanes_blocked() for layout in drawn]


@pytest.mark.parametrize("clearance", [0.31, 0.4])
def test_every_layout_is_crossed_with_clearance(clearance):
    for bridge in layouts(60):
        plan = plan_path(bridge, START, GOAL_X, PathPlannerOptions(clearance=clearance))
        assert plan.found
        np.testing.assert_array_equal(plan.path[0], START)
        assert plan.path[-1, 0] == GOAL_X
        path = shapely.LineString(plan.path)
        assert plan.length == pytest.approx(path.length)
        edge, boxes = shapes(bridge)
        assert min(path.distance(thing) for thing in (edge, *boxes)) >= clearance - 1e-6


@pytest.mark.slow
def test_paths_are_within_five_percent_of_what_an_optimal_planner_finds_in_seconds():
    for bridge in layouts(8, seed=1):
        patient = plan_path(bridge, START, GOAL_X, PathPlannerOptions(planner="BITstar", seconds=2.0))
        assert plan_path(bridge, START, GOAL_X).length <= 1.05 * patient.length


def test_an_empty_bridge_is_crossed_straight():
    plan = plan_path(BridgeMap(LENGTH, HALF_WIDTH, np.zeros((0, 5))), START, GOAL_X)
    assert plan.length == pytest.approx(18.0)


def test_the_same_plan_gives_the_same_path_whatever_was_planned_before():
    maps = layouts(10)
    forward = [plan_path(bridge, START, GOAL_X) for bridge in maps]
    backward = [plan_path(bridge, START, GOAL_X) for bridge in reversed(maps)][::-1]
    for a, b in zip(forward, backward, strict=True):
        np.testing.assert_array_equal(a.path, b.path)
        assert a.edges == b.edges
    other = [plan_path(bridge, START, GOAL_X, PathPlannerOptions(seed=99)) for bridge in maps]
    assert any(a.edges != b.edges for a, b in zip(forward, other, strict=True))


def test_a_walled_up_bridge_is_a_failure_and_no_path():
    wall = np.array([(10.0, 0.0, 0.0, 0.2, 1.39)])
    plan = plan_path(BridgeMap(LENGTH, HALF_WIDTH, wall), START, GOAL_X, PathPlannerOptions(edges=500))
    assert not plan.found
    assert plan.path.shape == (0, 2)
    assert plan.length == np.inf
    assert plan.edges <= 3 * 600


def test_from_beside_a_block_there_is_a_way_with_as_much_room():
    block = np.array([(1.0, 0.5, 0.0, 0.3, 0.2)])
    plan = plan_path(BridgeMap(LENGTH, HALF_WIDTH, block), START, GOAL_X)
    assert plan.found
    assert plan.clearance == pytest.approx(0.3, rel=0.01)


@pytest.mark.parametrize("planner", ["BITstar", "InformedRRTstar", "RRTstar"])
def test_other_planners_work_too(planner):
    plan = plan_path(layouts(1)[0], START, GOAL_X, PathPlannerOptions(planner=planner, seconds=0.5))
    assert plan.found
    assert plan.seconds > 0.4


@pytest.mark.parametrize(
    ("start", "goal_x"),
    [
        *(((np.nan, 0), 19), ((1,), 19), ("here", 19), (None, 19), ((1, 5), 19), ((-1, 0), 19)),
        *(((1, 0), np.inf), ((19, 0), 2), ((1, 0), 25)),
    ],
)
def test_unusable_starts_and_goals_are_refused(start, goal_x):
    with pytest.raises(ConfigurationError):
        plan_path(BridgeMap(LENGTH, HALF_WIDTH, np.zeros((0, 5))), start, goal_x)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"planner": "RTConnect"}, "RRTConnect"),
        ({"clearance": -1}, "clearance"),
        ({"tries": 0}, "tries"),
        ({"seconds": np.nan}, "seconds"),
    ],
)
def test_unusable_options_are_refused(options, message):
    with pytest.raises(ConfigurationError, match=message):
        PathPlannerOptions(**options)
