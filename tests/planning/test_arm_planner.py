import dataclasses
import itertools
import subprocess
import sys

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.kinematics import ArmModel, Workspace
from armctl.planning import ArmPlanner, ArmPlannerOptions, plan_path
from armctl.scene import NO_BOXES, Boxes
from armctl.tasks.reach.obstacle_layout import sample_layout

from ..arms import named_arm
from ..capsule_world import CapsuleWorld
from ..scene.test_bridge_map import random_map

TOLERANCE = 0.05


class Case:
    def __init__(self, robot):
        self.model = ArmModel(robot)
        self.planner = ArmPlanner(self.model)
        self.workspace = Workspace(self.model)

    def layouts(self, count, seed=0):
        rng = np.random.default_rng(seed)
        return [sample_layout(rng, self.workspace, TOLERANCE) for _ in range(count)]

    def plan(self, layout):
        return self.planner.plan(self.model.home, layout.target, TOLERANCE, layout.boxes)


@pytest.fixture(scope="module")
def ur5():
    return Case("ur5")


@pytest.fixture(scope="module", params=["ur5", "ur3", "ur10", "panda"])
def case(request):
    return Case(named_arm(request.param, home=(0, -0.785, 0, -2.356, 0, 1.571, 0.785)))


def densely(path):
    """Configurations along a path, no joint moving by more than 0.02 rad from one to the next."""
    for a, b in itertools.pairwise(path):
        yield from np.linspace(a, b, 1 + int(np.ceil(np.abs(b - a).max() / 0.02)))


def cage(around, half_width, thickness=0.02):
    """Six boxes around a point."""
    axes, thin = np.vstack((np.eye(3), -np.eye(3))), np.abs(np.vstack((np.eye(3), np.eye(3))))
    sizes = np.where(thin > 0, thickness, half_width + 2 * thickness)
    return Boxes(around + axes * (half_width + thickness), sizes, np.zeros(6))


@pytest.mark.one_case
def test_paths_are_free_in_mujoco_and_end_in_the_sphere(case):
    found = searched = 0
    for layout in case.layouts(16):
        plan = case.plan(layout)
        if not plan.solved:
            continue
        found, searched = found + 1, searched + plan.searched
        world, among = CapsuleWorld(case.model, layout.boxes), case.model.among(layout.boxes)
        np.testing.assert_array_equal(plan.path[0], case.model.home)
        assert np.linalg.norm(case.model.position(plan.path[-1]) - layout.target) <= TOLERANCE
        assert case.model.within_limits(plan.path).all()
        kept = min(0.01, world.distance(case.model.home) / 3)
        for q in densely(plan.path):
            assert world.distance(q) >= kept - 1e-5
            assert among.is_free(q)
        assert plan.clearance == pytest.approx(min(world.outer_distance(q) for q in plan.path), abs=1e-5)
        assert plan.time == pytest.approx(case.model.cruise_time(plan.path[:-1], plan.path[1:]).sum())
        assert plan.time <= plan.raw_time
    assert found >= 13
    assert searched >= 2


def test_nearly_all_layouts_are_solved_and_straight_motions_are_not_enough(ur5):
    plans = [ur5.plan(layout) for layout in ur5.layouts(50, seed=1)]
    assert np.mean([plan.solved for plan in plans]) >= 0.98
    assert np.mean([plan.searched for plan in plans]) >= 0.3
    assert np.median([plan.checks for plan in plans]) <= 400
    assert max(plan.checks for plan in plans) <= 8000


def test_the_same_plan_gives_the_same_path_whatever_was_planned_before(ur5):
    layouts = ur5.layouts(12, seed=2)
    forward = [ur5.plan(layout) for layout in layouts]
    assert sum(plan.searched for plan in forward) >= 2
    rng, backward = np.random.default_rng(0), []
    for layout in reversed(layouts):
        plan_path(random_map(rng, blocks=4), (1.0, 0.0), 19.0)
        other = Case("ur5") if len(backward) % 5 == 0 else ur5
        backward.insert(0, other.plan(layout))
    for a, b in zip(forward, backward, strict=True):
        np.testing.assert_array_equal(a.path, b.path)
        assert (a.checks, a.searched, a.raw_time) == (b.checks, b.searched, b.raw_time)


@pytest.mark.slow
def test_another_process_finds_the_same_path(ur5):
    layout = next(layout for layout in ur5.layouts(20, seed=3) if ur5.plan(layout).searched)
    boxes = (layout.boxes.centres.tolist(), layout.boxes.half_sizes.tolist(), layout.boxes.yaws.tolist())
    code = (
        "import numpy as np; from armctl.scene import Boxes; from armctl.kinematics import ArmModel\n"
        f"from armctl.planning import ArmPlanner; arm = ArmModel(); boxes = Boxes(*map(np.array, {boxes}))\n"
        f"print(ArmPlanner(arm).plan(arm.home, {layout.target.tolist()}, {TOLERANCE}, boxes).path.tolist())"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (run.stdout.strip(), run.stderr) == (str(ur5.plan(layout).path.tolist()), "")


@pytest.mark.slow
def test_without_boxes_the_way_is_as_straight_as_soon(case):
    rng = np.random.default_rng(4)
    for _ in range(15):
        target = case.workspace.sample(rng, TOLERANCE)
        plan = case.planner.plan(case.model.home, target, TOLERANCE, NO_BOXES)
        assert plan.solved
        if len(plan.path) == 2:
            assert plan.time == pytest.approx(case.model.cruise_time(*plan.path))


def test_boxes_cost_time_and_shortcuts_save_it(ur5):
    plain = ArmPlanner(ur5.model, ArmPlannerOptions(shortcuts=0))
    free, raw, short = [], [], []
    for layout in ur5.layouts(24, seed=5):
        plan = ur5.plan(layout)
        if plan.searched and plan.solved:
            short.append(plan.time)
            raw.append(plain.plan(ur5.model.home, layout.target, TOLERANCE, layout.boxes).time)
            free.append(ur5.planner.plan(ur5.model.home, layout.target, TOLERANCE, NO_BOXES).time)
    assert np.mean(free) < np.mean(short) < 0.7 * np.mean(raw)


def test_an_enclosed_target_is_not_found_within_bounded_effort(ur5):
    target = np.array((0.6, 0.3, 0.4))
    plan = ur5.planner.plan(ur5.model.home, target, TOLERANCE, cage(target, 0.15))
    assert not plan.solved
    assert plan.path.shape == (0, 6)
    assert plan.time == plan.raw_time == np.inf
    assert np.isnan(plan.clearance)


def test_a_search_without_a_way_gives_up(ur5):
    """A frame around the forearm at home: there are free configurations in the sphere, but no way out of the frame."""
    forearm, thin, wide = np.array((0.2, 0.028, 0.514)), (0.02, 0.02, 0.2), (0.02, 0.2, 0.02)
    sides = 0.12 * np.array([(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
    frame = Boxes(forearm + sides, np.array([thin, thin, wide, wide]), np.zeros(4))
    assert (ur5.model.box_distances(ur5.model.home, frame) > 0.02).all()
    plan = ur5.planner.plan(ur5.model.home, (-0.5, 0.0, 0.3), TOLERANCE, frame)
    assert plan.searched
    assert not plan.solved
    assert plan.checks <= ArmPlannerOptions().checks + 500


def test_targets_out_of_reach_are_not_found(case):
    for target in ((5.0, 0, 0.5), (0, 0, -0.5)):
        assert not case.planner.plan(case.model.home, target, TOLERANCE, NO_BOXES).solved


def test_a_start_that_touches_something_is_not_left(ur5):
    boxes = Boxes(ur5.model.position(ur5.model.home)[None], np.full((1, 3), 0.05), np.zeros(1))
    plan = ur5.planner.plan(ur5.model.home, (-0.5, 0.2, 0.4), TOLERANCE, boxes)
    assert not plan.solved
    assert not plan.searched


def test_a_start_beside_a_box_is_left_with_part_of_the_clearance_that_it_has(ur5):
    at, boxes = ur5.model.position(ur5.model.home), None
    for x in np.arange(0.3, 0.0, -0.0005):
        nearer = Boxes(at + np.array([[x, 0, 0]]), np.full((1, 3), 0.05), np.zeros(1))
        if ur5.model.box_distances(ur5.model.home, nearer)[0] < 0.005:
            break
        boxes = nearer
    gap = ur5.model.box_distances(ur5.model.home, boxes)[0]
    assert gap < 0.006
    plan, world = ur5.planner.plan(ur5.model.home, (-0.5, 0.2, 0.4), TOLERANCE, boxes), CapsuleWorld(ur5.model, boxes)
    assert plan.solved
    assert plan.clearance <= gap + 1e-5
    assert min(world.distance(q) for q in densely(plan.path)) >= gap / 3 - 1e-5


def test_an_arm_without_shapes_moves_through_everything(ur5):
    ghost = ArmModel(dataclasses.replace(ur5.model.description, capsules=(), collision_pairs=()))
    target = (-0.5, 0.2, 0.4)
    plan = ArmPlanner(ghost).plan(ghost.home, target, TOLERANCE, cage(np.array(target), 0.1))
    assert len(plan.path) == 2


@pytest.mark.parametrize("clearance", [0.001, 0.05])
def test_other_clearances_are_kept_too(ur5, clearance):
    planner, found = ArmPlanner(ur5.model, ArmPlannerOptions(clearance=clearance)), 0
    for layout in ur5.layouts(15, seed=6):
        plan = planner.plan(ur5.model.home, layout.target, TOLERANCE, layout.boxes)
        world = CapsuleWorld(ur5.model, layout.boxes)
        kept = min(clearance, world.distance(ur5.model.home) / 3)
        found += plan.solved
        assert all(world.distance(q) >= kept - 1e-5 for q in densely(plan.path))
    assert found >= 5


def test_being_there_already_is_a_path_without_a_way(ur5):
    plan = ur5.planner.plan(ur5.model.home, ur5.model.position(ur5.model.home) + 0.02, TOLERANCE, NO_BOXES)
    assert plan.solved
    np.testing.assert_array_equal(plan.path, ur5.model.home[None])
    assert plan.time == 0


def test_starts_at_a_joint_limit_and_arguments_untouched(ur5):
    start = np.where([1, 0, 0, 0, 0, 1], ur5.model.limits.upper, ur5.model.home)
    target, before = np.array((0.4, 0.4, 0.4)), start.copy()
    plan = ur5.planner.plan(start, target, TOLERANCE, NO_BOXES)
    assert plan.solved
    assert ur5.model.within_limits(plan.path).all()
    np.testing.assert_array_equal(start, before)
    np.testing.assert_array_equal(target, (0.4, 0.4, 0.4))


HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)


@pytest.mark.parametrize(
    ("start", "target", "tolerance"),
    [
        *(((0, 0), (0.5, 0, 0.5), 0.05), ((np.nan,) * 6, (0.5, 0, 0.5), 0.05), ((7,) * 6, (0.5, 0, 0.5), 0.05)),
        *((None, (0.5, 0, 0.5), 0.05), ("home", (0.5, 0, 0.5), 0.05), (HOME, (0.5, 0), 0.05), (HOME, None, 0.05)),
        *((HOME, (np.inf, 0, 0.5), 0.05), (HOME, (0.5, 0, 0.5), -0.05), (HOME, (0.5, 0, 0.5), 0)),
        *((HOME, (0.5, 0, 0.5), np.nan), (HOME, (0.5, 0, 0.5), np.inf), (HOME, (0.5, 0, 0.5), (0.1, 0.1))),
        (HOME, (0.5, 0, 0.5), "near"),
    ],
)
def test_unusable_starts_and_spheres_are_refused(ur5, start, target, tolerance):
    with pytest.raises(ConfigurationError):
        ur5.planner.plan(start, target, tolerance, NO_BOXES)


@pytest.mark.parametrize(
    "options",
    [
        *({"clearance": value} for value in (0, np.nan, 0.2, "wide")),
        *({name: value} for name, value in (("stride", -1), ("goals", 0), ("checks", 1.5), ("direct", -1))),
        {"shortcuts": None},
    ],
)
def test_unusable_options_are_refused(options):
    with pytest.raises(ConfigurationError, match=next(iter(options))):
        ArmPlannerOptions(**options)
