import numpy as np
import pytest

from armctl.control.streaming import follow
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker, ImaginedArms
from armctl.kinematics.imagined import ARRIVED, MOVING, TOUCHED
from armctl.robot_description.joint_profiles import TICK
from armctl.scene import Boxes

from ..arms import random_boxes

PERIOD = 0.04
FAR = np.array([9.0, 9.0, 9.0])


@pytest.fixture(scope="module")
def shapes():
    return ArmShapes(ArmModel("ur5"))


def arms(shapes, n, most=0, **options):
    return ImaginedArms(shapes, n, most, **{"tolerance": 0.05, "period": PERIOD} | options)


def box_numbers(rng, model, n, most):
    """Numbers (n, most, 7) of random boxes: absent ones last."""
    numbers = np.zeros((n, most, 7))
    for row in numbers:
        count = rng.integers(0, most + 1)
        boxes = random_boxes(rng, model, count)
        row[:count] = np.column_stack((boxes.centres, boxes.half_sizes, boxes.yaws))
    return numbers


def boxes_of(numbers):
    rows = numbers[(numbers[:, 3:6] > 0).all(axis=1)]
    return Boxes(rows[:, :3], rows[:, 3:6], rows[:, 6])


def test_arms_move_by_the_law_of_their_drives(shapes):
    model, rng = shapes.model, np.random.default_rng(0)
    imagined = arms(shapes, 20)
    imagined.begin(np.arange(20), np.tile(model.home, (20, 1)), 0.0, np.tile(FAR, (20, 1)), np.zeros((20, 0, 7)))
    expected, velocities = imagined.positions.copy(), np.zeros((20, 6))
    for _ in range(8):
        commands = np.clip(expected + rng.uniform(-0.3, 0.3, (20, 6)), model.limits.lower, model.limits.upper)
        imagined.move(commands)
        for i in np.flatnonzero(imagined.states == MOVING):
            expected[i], velocities[i] = follow(model.limits, expected[i], velocities[i], commands[i], PERIOD)
    moving = imagined.states == MOVING
    assert moving.sum() > 10
    np.testing.assert_allclose(imagined.positions[moving], expected[moving], atol=1e-12)
    np.testing.assert_allclose(imagined.velocities[moving], velocities[moving], atol=1e-12)


def test_the_simulated_arm_follows_what_is_imagined(shapes):
    """In free motion, joints are within 0.03 rad of the imagined commands, which are the simulation's own."""
    worlds = make_worlds("armctl/ArmReachObstacles-v0", 8, {})
    worlds.reset(seed=3)
    task, rng = worlds.task, np.random.default_rng(0)
    imagined, home = arms(shapes, 8), task.arm.joint_positions.copy()
    imagined.begin(np.arange(8), home, 0.0, np.tile(FAR, (8, 1)), np.zeros((8, 0, 7)))
    for _ in range(6):
        commands = home + rng.uniform(-0.1, 0.1, home.shape)
        worlds.step(commands.astype(np.float32))
        imagined.move(commands.astype(np.float32))
        np.testing.assert_allclose(task.arm.drive_commands[0], imagined.positions, atol=1e-6)
        np.testing.assert_allclose(task.arm.joint_positions, imagined.positions, atol=0.03)
    worlds.close()


@pytest.mark.one_case
@pytest.mark.parametrize("margin", [0.0, 0.02])
def test_touches_are_those_that_an_edge_checker_would_see(shapes, margin):
    model, rng, n = shapes.model, np.random.default_rng(1), 40
    numbers = box_numbers(rng, model, n, 5)
    imagined = arms(shapes, n, 5, margin=margin, period=TICK)
    imagined.begin(np.arange(n), np.tile(model.home, (n, 1)), 0.0, np.tile(FAR, (n, 1)), numbers)
    goals = model.home + rng.uniform(-1.5, 1.5, (n, 6))
    for _ in range(80):
        before = imagined.states.copy()
        imagined.move(goals)
        for i in np.flatnonzero(before == MOVING):
            checker = EdgeChecker(shapes, boxes_of(numbers[i]), 0.01, model.home)
            distances = checker._measured(imagined.positions[i])
            needed = np.minimum(margin, 0.5 * checker._measured(model.home))
            assert (imagined.states[i] == TOUCHED) == bool((distances < needed).any())
    assert {MOVING, TOUCHED} <= set(imagined.states)


def test_free_waypoints_are_safe_and_the_farthest(shapes):
    """A dense sample of each motion that is called free keeps two thirds of the margin; farther ones do not."""
    model, rng, n, margin = shapes.model, np.random.default_rng(2), 30, 0.02
    numbers = box_numbers(rng, model, n, 5)
    imagined = arms(shapes, n, 5)
    imagined.begin(np.arange(n), np.tile(model.home, (n, 1)), 0.0, np.tile(FAR, (n, 1)), numbers)
    ways = model.home + np.linspace(0, 1, 5)[:, None] * rng.uniform(-2, 2, (n, 1, 6))
    lengths, found = rng.integers(2, 6, n), np.ones(n, dtype=int)
    imagined.next_waypoints(ways, lengths, margin, found)
    assert (found < lengths).all()
    assert len(set(found)) > 1
    for i in range(n):
        checker = EdgeChecker(shapes, boxes_of(numbers[i]), margin / 1.5, model.home)
        kept = np.minimum(margin, 0.5 * checker._measured(model.home)) / 1.5
        sampled = model.home + np.linspace(0, 1, 200)[:, None] * (ways[i, found[i]] - model.home)
        if found[i] > 1:
            assert all((checker._measured(q) >= kept - 1e-9).all() for q in sampled)
        assert not any(checker.is_edge_free(model.home, ways[i, k]) for k in range(found[i] + 1, lengths[i]))


def test_arms_arrive_in_their_sphere_and_stand_still_then(shapes):
    model = shapes.model
    goals = model.home + np.array([[0.4, 0, 0, 0, 0, 0], [0.0, 0.2, 0, 0, 0, 0]])
    imagined = arms(shapes, 2)
    imagined.begin([0, 1], np.tile(model.home, (2, 1)), 0.0, np.array([model.position(goals[0]), FAR]), np.zeros(0))
    for _ in range(20):
        imagined.move(goals)
    assert imagined.states.tolist() == [ARRIVED, MOVING]
    assert np.linalg.norm(imagined.tips[0] - imagined.targets[0]) <= 0.05
    at = imagined.positions[0].copy()
    imagined.move(goals + 0.1)
    np.testing.assert_array_equal(imagined.positions[0], at)
    np.testing.assert_allclose(imagined.positions[1], goals[1] + [0, 0, 0, 0, 0, 0], atol=0.2)


def test_each_arm_moves_as_if_it_were_alone(shapes):
    model, rng, n = shapes.model, np.random.default_rng(4), 6
    numbers, goals = box_numbers(rng, model, n, 4), model.home + rng.uniform(-1, 1, (n, 6))
    together = arms(shapes, n, 4)
    together.begin(np.arange(n), np.tile(model.home, (n, 1)), 0.0, np.tile(FAR, (n, 1)), numbers)
    for _ in range(10):
        together.move(goals)
    for i in range(n):
        alone = arms(shapes, 1, 4)
        alone.begin([0], model.home[None], 0.0, FAR[None], numbers[i : i + 1])
        for _ in range(10):
            alone.move(goals[i : i + 1])
        np.testing.assert_array_equal(alone.positions[0], together.positions[i])
        assert alone.states[0] == together.states[i]


@pytest.mark.parametrize("margin", [-0.01, np.nan, np.inf])
def test_margins_are_checked(shapes, margin):
    with pytest.raises(ConfigurationError, match="margin"):
        arms(shapes, 1, margin=margin)
