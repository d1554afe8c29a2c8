import itertools

import numpy as np
import pytest

from armctl.control.streaming import follow
from armctl.core.errors import ConfigurationError
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker
from armctl.scene import NO_BOXES, Boxes

from ..arms import named_arm, random_boxes
from ..capsule_world import CapsuleWorld

CLEARANCE = 0.01


@pytest.fixture(scope="module", params=["ur5", "ur10", "panda"])
def model(request):
    return ArmModel(named_arm(request.param))


@pytest.fixture(scope="module")
def shapes(model):
    return ArmShapes(model)


def configurations(model, rng, count):
    low, high = np.maximum(model.limits.lower, -np.pi), np.minimum(model.limits.upper, np.pi)
    return rng.uniform(low, high, (count, model.dof))


def short_ways(model, rng, count):
    """Pairs of configurations 0.02 to 2 rad apart."""
    steps = rng.normal(size=(count, model.dof))
    steps *= rng.uniform(0.02, 2, (count, 1)) / np.linalg.norm(steps, axis=1, keepdims=True)
    starts = configurations(model, rng, count)
    return zip(starts, np.clip(starts + steps, model.limits.lower, model.limits.upper), strict=True)


def test_no_distance_changes_by_more_than_the_motion_that_is_reckoned_with(model, shapes):
    rng = np.random.default_rng(0)
    boxes = random_boxes(rng, model)
    motion, checker = shapes.with_boxes(boxes)[1], EdgeChecker(shapes, boxes, CLEARANCE, model.home)

    def measured(q):
        return checker._measured(q)

    for a, b in short_ways(model, rng, 500):
        before, after = measured(a), measured(b)
        apart = (before > 0) & (after > 0)  # penetration depths are another thing
        assert (np.abs(after - before) <= motion @ np.abs(b - a) + 1e-6)[apart].all()


def test_what_is_free_by_capsules_is_free_here_and_the_other_way_around(model, shapes):
    rng = np.random.default_rng(1)
    boxes = random_boxes(rng, model)
    among, motions = model.among(boxes), EdgeChecker(shapes, boxes, 1e-9, model.home)
    free = [(among.is_free(q), motions.is_free(q)) for q in configurations(model, rng, 2000)]
    assert len({a for a, _ in free}) == 2
    assert all(a == b for a, b in free)


def test_a_motion_that_leads_keeps_the_clearance_by_mujoco(model, shapes):
    rng, led = np.random.default_rng(2), 0
    for _ in range(8):
        boxes = random_boxes(rng, model)
        world, motions = CapsuleWorld(model, boxes), EdgeChecker(shapes, boxes, CLEARANCE, model.home)
        for a, b in short_ways(model, rng, 100):
            if motions.is_edge_free(a, b):
                led += 1
                nearest = min(world.distance(q) for q in np.linspace(a, b, 60))
                assert nearest >= CLEARANCE - 1e-5
    assert led > 100


@pytest.mark.slow
def test_a_motion_with_more_than_the_clearance_leads(model, shapes):
    rng, wide = np.random.default_rng(3), 0
    for _ in range(8):
        boxes = random_boxes(rng, model)
        world, motions = CapsuleWorld(model, boxes), EdgeChecker(shapes, boxes, CLEARANCE, model.home)
        for a, b in short_ways(model, rng, 100):
            if min(world.distance(q) for q in np.linspace(a, b, 60)) > 2 * CLEARANCE:
                wide += 1
                assert motions.is_edge_free(a, b)
                assert motions.is_edge_free(b, a)
    assert wide > 50


def test_thin_walls_are_not_jumped_over(model, shapes):
    """A sheet of 2 mm, met by the end-effector somewhere between two free configurations."""
    rng, met = np.random.default_rng(4), 0
    among, low = EdgeChecker(shapes, NO_BOXES, CLEARANCE, model.home), model.limits.lower
    for a, b in short_ways(model, rng, 400):
        if not among.is_edge_free(a, b) or not (b >= low).all():
            continue
        middle = model.position((a + b) / 2)
        along = model.position(b) - model.position(a)
        sheet = Boxes(middle[None], np.array([[0.001, 0.05, 0.05]]), np.arctan2(along[1:2], along[:1]))
        if model.box_distances(a, sheet)[0] < 0.02 or model.box_distances(b, sheet)[0] < 0.02:
            continue
        met += 1
        assert not EdgeChecker(shapes, sheet, CLEARANCE, a).is_edge_free(a, b)
    assert met > 5


def test_clearance_is_the_distance_from_boxes_and_floor_by_mujoco(model, shapes):
    rng = np.random.default_rng(5)
    boxes = random_boxes(rng, model)
    world, motions = CapsuleWorld(model, boxes), EdgeChecker(shapes, boxes, CLEARANCE, model.home)
    for q in (q for q in configurations(model, rng, 500) if motions.is_free(q)):
        assert motions.clearance(q[None]) == pytest.approx(world.outer_distance(q), abs=1e-5)


def test_what_is_near_at_the_start_need_keep_only_part_of_it(model, shapes):
    half_sizes, gap = np.full((1, 3), 0.05), 0.004
    at, up = model.position(model.home), np.array((0, 0, 1.0))
    low, high = 0.0, 1.0  # the box's height above the end-effector: down to where it all but touches
    for _ in range(60):
        middle = (low + high) / 2
        above = Boxes((at + middle * up)[None], half_sizes, np.zeros(1))
        low, high = (low, middle) if model.box_distances(model.home, above)[0] > gap else (middle, high)
    above = Boxes((at + high * up)[None], half_sizes, np.zeros(1))
    motions, world = EdgeChecker(shapes, above, CLEARANCE, model.home), CapsuleWorld(model, above)
    assert motions.clearance(model.home[None]) == pytest.approx(gap, abs=1e-5)
    assert motions.is_free(model.home)
    led = 0
    for _, b in short_ways(model, np.random.default_rng(6), 300):
        if motions.is_edge_free(model.home, b):
            led += 1
            assert min(world.distance(q) for q in np.linspace(model.home, b, 100)) >= gap / 3 - 1e-5
    assert led > 5


def test_a_start_that_touches_is_said_to(shapes, model):
    boxes = Boxes(model.position(model.home)[None], np.full((1, 3), 0.1), np.zeros(1))
    assert not EdgeChecker(shapes, boxes, CLEARANCE, model.home).start_is_free


@pytest.mark.parametrize("clearance", [0.0, -0.01, 0.06, np.nan])
def test_clearances_out_of_range_are_refused(shapes, model, clearance):
    with pytest.raises(ConfigurationError, match="clearance"):
        EdgeChecker(shapes, NO_BOXES, clearance, model.home)


def test_shortcuts_are_free_save_time_and_keep_the_ends(model, shapes):
    rng, shorter = np.random.default_rng(7), 0
    for _ in range(20):
        checker = EdgeChecker(shapes, random_boxes(rng, model), CLEARANCE, model.home)
        path = model.home[None]
        while len(path) < 8:
            corner = path[-1] + rng.uniform(-0.4, 0.4, model.dof)
            if checker.is_edge_free(path[-1], corner):
                path = np.vstack((path, corner))
        cut = checker.shortened(path, rng.random((30, 2)), 0.99)
        np.testing.assert_array_equal(cut[[0, -1]], path[[0, -1]])
        assert all(checker.is_edge_free(a, b) for a, b in itertools.pairwise(cut))
        before, after = (model.cruise_time(one[:-1], one[1:]).sum() for one in (path, cut))
        assert after <= before + 1e-12
        shorter += after < 0.99 * before
    assert shorter > 10


def free_path(checker, start, rng, corners=10):
    path = start[None]
    while len(path) < corners:
        corner = path[-1] + rng.uniform(-0.9, 0.9, len(start))
        if checker.is_edge_free(path[-1], corner):
            path = np.vstack((path, corner))
    return path


@pytest.mark.one_case
def test_the_farthest_goal_is_free_and_hardly_anything_behind_it_is(model, shapes):
    rng, cut = np.random.default_rng(8), 0
    for _ in range(30):
        checker = EdgeChecker(shapes, random_boxes(rng, model, 12), CLEARANCE, model.home)
        path = free_path(checker, model.home, rng)
        q = path[1]
        goal = checker.farthest_goal(path, q)
        assert checker.is_edge_free(q, goal)
        shares = np.linspace(0, 1, 20)[:, None]
        points = np.vstack([a + shares * (b - a) for a, b in itertools.pairwise(path)])
        reached = int(np.argmin(np.abs(points - goal).sum(axis=1)))
        free = [checker.is_edge_free(q, point) for point in points]
        corners_behind = [k for k in range(len(points)) if k > reached + 1 and k % 20 in (0, 19)]
        assert not any(free[k] for k in corners_behind)
        cut += reached < len(points) - 2
    assert cut > 2


def test_there_is_no_goal_from_within_a_box_nor_on_no_path(model, shapes):
    boxes = Boxes(model.position(model.home)[None], np.full((1, 3), 0.1), np.zeros(1))
    checker = EdgeChecker(shapes, boxes, CLEARANCE, model.home)
    checker.relax(model.home, 0.9)
    assert checker.farthest_goal(np.array([model.home, model.home + 0.5]), model.home) is None
    free = EdgeChecker(shapes, NO_BOXES, CLEARANCE, model.home)
    assert free.farthest_goal(np.zeros((0, model.dof)), model.home) is None
    np.testing.assert_array_equal(free.farthest_goal(model.home[None], model.home), model.home)


def test_relaxed_pairs_keep_their_share_and_no_others_change(model, shapes):
    rng = np.random.default_rng(9)
    checker = EdgeChecker(shapes, random_boxes(rng, model), 0.02, model.home)
    wanted, near = checker._bounds.margins.copy(), 0
    for q in configurations(model, rng, 300):
        distances = checker._measured(q)
        too_near = checker.relax(q, 0.7)
        assert too_near == (distances < wanted).any()
        np.testing.assert_allclose(checker._bounds.margins, np.minimum(wanted, 0.7 * np.maximum(distances, 0)))
        near += bool(too_near and (distances > 0).all() and checker.is_free(q))
    assert near > 0  # what is too near, but touches nothing, may move


def test_drives_stop_freely_where_their_own_motion_is_free(model, shapes):
    rng, told = np.random.default_rng(10), []
    limits = model.limits
    for _ in range(10):
        boxes = random_boxes(rng, model)
        checker, world = EdgeChecker(shapes, boxes, CLEARANCE, model.home), CapsuleWorld(model, boxes)
        for a, b in short_ways(model, rng, 30):
            velocity = rng.uniform(-0.3, 0.3, model.dof) * limits.velocity
            told.append(checker.stops_freely(a, velocity, b))
            position, speed = a, velocity
            for _ in range(40 if told[-1] else 0):
                position, speed = follow(limits, position, speed, b, 0.008)
                assert world.distance(position) > CLEARANCE / 2
    assert 10 < sum(told) < len(told) - 10
