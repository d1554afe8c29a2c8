import subprocess
import sys

import numpy as np
import pytest
import shapely
from scipy.sparse.csgraph import dijkstra

from armctl.core.errors import ConfigurationError
from armctl.kernels.bridge import may_pass, measure, reach_among
from armctl.planning import PathPlannerOptions, plan_path
from armctl.planning.bridge_planner import _by_ompl, _march, _points, _search
from armctl.scene import BridgeMap, PedestrianTrajectories
from armctl.tasks.bridge.layout import sample_layout

from ..scene.test_bridge_map import HALF_WIDTH, LENGTH, random_map, shapes

START, GOAL_X = (1.0, 0.0), 19.0
NOTHING = BridgeMap(LENGTH, HALF_WIDTH, np.zeros((0, 5)))


def layouts(count, seed=0):
    rng = np.random.default_rng(seed)
    return [sample_layout(rng, LENGTH, 4.0, *((7, 0) if i % 2 else (3, 3)), 1).map for i in range(count)]


def assert_crosses_with_clearance(bridge, plan, clearance):
    assert plan.solved
    np.testing.assert_array_equal(plan.path[0], START)
    assert plan.path[-1, 0] == GOAL_X
    path = shapely.LineString(plan.path)
    assert plan.length == pytest.approx(path.length)
    edge, boxes = shapes(bridge.with_lanes_blocked())
    measured = min(path.distance(thing) for thing in (edge, *boxes))
    assert measured >= clearance - 1e-6
    assert plan.clearance == pytest.approx(measured)


@pytest.mark.parametrize("clearance", [0.31, 0.4])
def test_every_layout_is_crossed_with_clearance(clearance):
    for bridge in layouts(60):
        plan = plan_path(bridge, START, GOAL_X, PathPlannerOptions(clearance=clearance))
        assert_crosses_with_clearance(bridge, plan, clearance)


@pytest.mark.slow
def test_there_is_a_path_wherever_the_map_can_be_crossed_however_narrow_its_gaps():
    rng, narrow, walled_up = np.random.default_rng(4), 0, 0
    while narrow < 40:
        bridge, clearance = random_map(rng, blocks=int(rng.integers(3, 9))), float(rng.uniform(0.3, 0.5))
        if not bridge.crossable(clearance):
            walled_up += 1
            if walled_up <= 20:
                assert not plan_path(bridge, START, GOAL_X, PathPlannerOptions(clearance=clearance)).solved
        elif not bridge.crossable(clearance + 0.01) and bridge.clearance([START])[0] >= clearance:
            narrow += 1
            plan = plan_path(bridge, START, GOAL_X, PathPlannerOptions(clearance=clearance))
            assert_crosses_with_clearance(bridge, plan, clearance)


def test_a_gap_just_wide_enough_is_one():
    bridge = BridgeMap(LENGTH, 1.4, np.array([(10, 0.4, 0, 0.2, 0.6), (14, -0.9, np.pi / 2, 0.5, 0.2)]))
    assert bridge.crossable(0.4)
    assert_crosses_with_clearance(bridge, plan_path(bridge, START, GOAL_X), 0.4)


def shortest_length(bridge, clearance):
    """By a visibility graph over points every 6 degrees around the corners: at most 0.15 % longer than the shortest."""
    turns = np.radians(np.arange(0, 360, 6))
    ring = (clearance + 1e-9) / np.cos(np.radians(3)) * np.column_stack((np.cos(turns), np.sin(turns)))
    points = np.vstack((START, (bridge.corners.reshape(-1, 1, 2) + ring).reshape(-1, 2)))
    points = points[bridge.clearance(points) >= clearance]
    at_goal = np.column_stack((np.full(len(points), GOAL_X), points[:, 1]))
    graph = np.zeros((len(points) + 1, len(points) + 1))
    i, j = np.triu_indices(len(points), k=1)
    free = bridge.segment_clearance(points[i], points[j]) >= clearance
    graph[i[free], j[free]] = np.linalg.norm(points[i] - points[j], axis=1)[free]
    graph[:-1, -1] = np.where(bridge.segment_clearance(points, at_goal) >= clearance, GOAL_X - points[:, 0], 0)
    return dijkstra(graph, directed=False, indices=[0])[0, -1]


def test_paths_are_hardly_longer_than_the_shortest():
    ratios = [
        plan_path(bridge, START, GOAL_X).length / shortest_length(bridge.with_lanes_blocked(), 0.4)
        for bridge in layouts(40, seed=1)
    ]
    assert np.median(ratios) <= 1.002
    assert max(ratios) <= 1.01


@pytest.mark.parametrize("shape", [(10, 3), (40, 9)])  # all points are neighbours, or only the nearest
def test_the_compiled_search_finds_the_path_of_ompls(shape):
    rng, solved = np.random.default_rng(0), 0
    lines = np.meshgrid(np.linspace(1.5, GOAL_X, shape[0]), np.linspace(-1, 1, shape[1]))  # many paths of equal length
    for bridge in layouts(12):
        lattice = np.column_stack([line.ravel() for line in lines]) - 1e-8 * rng.random((np.prod(shape), 2))
        points = np.vstack((START, lattice, np.column_stack((np.full(9, GOAL_X), np.linspace(-1, 1, 9)))))
        points = points[bridge.clearance(points) >= 0.3]
        path = _march(bridge, points, GOAL_X, 0.3)
        np.testing.assert_array_equal(path, _by_ompl(bridge, points, GOAL_X, 0.3)[0])
        solved += len(path) > 0
    assert solved >= 3


@pytest.mark.parametrize("on_grid", [False, True])
def test_reach_is_the_distance_of_the_last_neighbour(on_grid):
    rng = np.random.default_rng(0)
    for _ in range(40):
        n, neighbors = rng.integers(1, 80, 2).tolist()
        points = rng.integers(0, 4, (n, 2)).astype(float) if on_grid else rng.random((n, 2)) * (10, 2)
        distances, within = np.empty(n), rng.choice((0.5, np.inf))
        for i, actual in enumerate(np.linalg.norm(points[:, None] - points, axis=-1)):
            measure(points, i, distances)
            np.testing.assert_allclose(distances, actual, rtol=1e-12)
            last = np.sort(distances)[neighbors - 1] if neighbors <= n else np.inf
            assert reach_among(distances, neighbors, within, np.empty(n)) == last


@pytest.mark.parametrize("cell", [0.05, 0.3])
def test_no_path_is_ruled_out_that_there_is(cell):
    ruled_out = 0
    for bridge in layouts(40):
        for clearance in (0.3, 0.45, 0.6):
            points = _points(bridge, clearance, 400)
            path, _ = _search(bridge, np.array(START), GOAL_X, clearance, points)
            is_open = may_pass(bridge.deck, clearance, np.array(START), GOAL_X, cell)
            assert is_open or not len(path)
            ruled_out += not is_open
    assert ruled_out >= 3


def test_an_empty_bridge_is_crossed_straight():
    np.testing.assert_allclose(plan_path(NOTHING, START, GOAL_X).path, (START, (GOAL_X, 0)), atol=1e-6)


def test_the_same_plan_gives_the_same_path_whatever_was_planned_before():
    alike = BridgeMap(LENGTH, HALF_WIDTH, np.array([(x, 0, 0, 0.3, 0.3) for x in (6, 10, 14)]))  # left and right
    maps = [alike, *layouts(10), NOTHING, alike]
    forward = [plan_path(bridge, START, GOAL_X) for bridge in maps]
    backward = [plan_path(bridge, START, GOAL_X) for bridge in reversed(maps)][::-1]
    for a, b in zip(forward, backward, strict=True):
        np.testing.assert_array_equal(a.path, b.path)
        assert a.edges == b.edges


def test_lanes_along_the_bridge_are_passed_beside():
    for bridge in layouts(10):
        np.testing.assert_array_equal(
            plan_path(bridge, START, GOAL_X).path, plan_path(bridge.with_lanes_blocked(), START, GOAL_X).path
        )


def test_a_walled_up_bridge_or_goal_is_a_failure_and_no_path():
    for x in (10.0, GOAL_X):
        wall = np.array([(x, 0.0, 0.0, 0.2, HALF_WIDTH)])
        plan = plan_path(BridgeMap(LENGTH, HALF_WIDTH, wall), START, GOAL_X)
        assert not plan.solved
        assert plan.path.shape == (0, 2)
        assert plan.length == np.inf
        assert np.isnan(plan.clearance)


def test_a_start_beside_a_block_is_left_for_where_there_is_clearance():
    bridge = BridgeMap(LENGTH, HALF_WIDTH, np.array([(1.0, 0.5, 0.0, 0.3, 0.2)]))
    plan = plan_path(bridge, START, GOAL_X)
    assert plan.clearance == pytest.approx(0.3, abs=1e-6)
    assert np.linalg.norm(plan.path[1] - START) < 0.15
    assert (bridge.segment_clearance(plan.path[1:-1], plan.path[2:]) >= 0.4 - 1e-6).all()


def test_a_start_in_a_gap_too_narrow_is_left_with_the_clearance_that_it_has():
    bridge = BridgeMap(LENGTH, HALF_WIDTH, np.array([(4.0, y, 0.0, 3.9, 0.55) for y in (-0.9, 0.9)]))
    plan = plan_path(bridge, START, GOAL_X)
    assert plan.solved
    assert plan.clearance == pytest.approx(0.35, abs=1e-6)


def test_a_start_in_a_lane_leaves_it():
    pedestrians = PedestrianTrajectories(np.array([(0.5, 0.0)]), np.array([(4.0, 0.0)]), np.ones(1), np.zeros(1), 0.25)
    plan = plan_path(BridgeMap(LENGTH, HALF_WIDTH, np.zeros((0, 5)), pedestrians), START, GOAL_X)
    assert plan.solved
    assert abs(plan.path[1, 1]) >= 0.65 - 1e-6


@pytest.mark.parametrize(
    ("start", "goal_x"),
    [
        *(((np.nan, 0), 19), ((1,), 19), ("here", 19), (None, 19), ((1, 5), 19), ((-1, 0), 19), ((5, 0), 19)),
        *(((1, 0), np.inf), ((19, 0), 2), ((1, 0), 25)),
    ],
)
def test_unusable_starts_and_goals_are_refused(start, goal_x):
    with pytest.raises(ConfigurationError):
        plan_path(BridgeMap(LENGTH, HALF_WIDTH, np.array([(5.0, 0, 0, 0.3, 0.3)])), start, goal_x)


@pytest.mark.parametrize("clearance", [-1, 0, np.nan, np.inf, "wide"])
def test_unusable_clearances_are_refused(clearance):
    with pytest.raises(ConfigurationError, match="clearance"):
        PathPlannerOptions(clearance=clearance)


@pytest.mark.slow
def test_ompl_says_nothing():
    code = (
        "import numpy as np; from armctl.planning import plan_path; from armctl.scene import BridgeMap; "
        "bridge = BridgeMap(20.0, 1.4, np.array([(10, 0, 0, 0.3, 0.3)])); print(plan_path(bridge, (1, 0), 19.0).solved)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (run.stdout, run.stderr) == ("True\n", "")
