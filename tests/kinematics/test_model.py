import mujoco
import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from armctl.kinematics import ArmModel
from armctl.robots import build_arm_world
from armctl.scene import Boxes

from ..arms import named_arm
from ..kernels.joint_profiles import travel_time

STEP = 1e-6
"""rad, of finite differences"""


@pytest.fixture(scope="module", params=["ur3", "ur5", "ur10", "panda"])
def model(request):
    return ArmModel(named_arm(request.param))


@pytest.fixture(scope="module")
def world(model):
    return build_arm_world(model.description, "torque")


def configurations(model, count, seed=0):
    low, high = np.maximum(model.limits.lower, -np.pi), np.minimum(model.limits.upper, np.pi)
    return np.random.default_rng(seed).uniform(low, high, (count, model.dof))


def turn(before, after):
    """Rotation vector (rad) from one rotation matrix to another, in the world's frame."""
    return Rotation.from_matrix(after @ before.T).as_rotvec()


def central_differences(function, q):
    """Columns (function(q + step e_j), function(q - step e_j)), for each joint j."""
    return [(function(q + step), function(q - step)) for step in STEP * np.eye(len(q))]


@pytest.mark.slow
def test_forward_kinematics_is_that_of_mujoco(model, world):
    data = mujoco.MjData(world)
    tip = data.body(f"arm/{model.description.tip}")
    for q in np.random.default_rng(0).uniform(model.limits.lower, model.limits.upper, (1000, model.dof)):
        data.qpos[:] = q
        mujoco.mj_kinematics(world, data)
        pose = model.pose(q)
        assert np.linalg.norm(pose[:3, 3] - tip.xpos) <= 1e-9
        assert np.linalg.norm(turn(pose[:3, :3], tip.xmat.reshape(3, 3))) <= 1e-9


def test_results_are_not_views_of_what_the_next_call_overwrites(model):
    first, second = configurations(model, 2)
    for function in (model.pose, model.position, model.jacobian, model.local_jacobian):
        kept = function(first)
        copy = kept.copy()
        function(second)
        np.testing.assert_array_equal(kept, copy)


def test_jacobian_is_the_derivative_of_the_pose(model):
    for q in configurations(model, 50):
        pairs = central_differences(model.pose, q)
        linear = [(after[:3, 3] - before[:3, 3]) / (2 * STEP) for after, before in pairs]
        angular = [turn(before[:3, :3], after[:3, :3]) / (2 * STEP) for after, before in pairs]
        np.testing.assert_allclose(model.jacobian(q), np.hstack([linear, angular]).T, atol=1e-8)


def test_local_jacobian_is_the_twist_of_the_pose(model):
    for q in configurations(model, 50):
        twists = [
            pinocchio.log6(pinocchio.SE3(before).actInv(pinocchio.SE3(after))).vector / (2 * STEP)
            for after, before in central_differences(model.pose, q)
        ]
        np.testing.assert_allclose(model.local_jacobian(q), np.transpose(twists), atol=1e-8)


def test_local_jacobian_integrates_to_the_pose(model):
    start, goal = configurations(model, 2)
    pose = pinocchio.SE3(model.pose(start))
    steps = 2000
    for part in (np.arange(steps) + 0.5) / steps:
        twist = model.local_jacobian(start + part * (goal - start)) @ (goal - start) / steps
        pose = pose * pinocchio.exp6(twist)
    np.testing.assert_allclose(pose.homogeneous, model.pose(goal), atol=1e-5)


@pytest.mark.parametrize("shape", [(), (1,), (7,), (3, 4), (0,)])
def test_batches_equal_single_configurations(model, shape):
    q = configurations(model, int(np.prod(shape))).reshape(*shape, model.dof)
    positions = model.positions(q)
    assert positions.shape == (*shape, 3)
    for i in np.ndindex(shape):
        np.testing.assert_allclose(positions[i], model.position(q[i]), atol=1e-12)


@pytest.mark.one_case
def test_is_free_where_mujoco_has_no_contact(model, world):
    nearly = 1e-4  # m; closer to touching than this, either may be right
    world.pair_margin[:] = nearly
    data = mujoco.MjData(world)
    free, touching = 0, 0
    for q in configurations(model, 3000):
        data.qpos[:] = q
        mujoco.mj_kinematics(world, data)
        mujoco.mj_collision(world, data)
        nearest = data.contact.dist.min(initial=nearly)
        if abs(nearest) >= nearly:
            assert model.is_free(q) == (nearest > 0), (q, nearest)
            free, touching = free + (nearest > 0), touching + (nearest < 0)
    world.pair_margin[:] = 0
    assert free > 500
    assert touching > 300


def test_home_is_free(model):
    assert model.is_free(model.home)


def test_usable_is_free_and_within_the_limits_whose_ends_count(model):
    lower, upper = model.limits.lower, model.limits.upper
    q = np.random.default_rng(1).uniform(lower - 0.2, upper + 0.2, (400, model.dof))
    q[:100] = np.clip(q[:100], lower, upper)
    q[100, 0] = np.nan
    expected = model.within_limits(q) & model.are_free(q)
    np.testing.assert_array_equal(model.are_usable(q), expected)
    assert 0 < expected[:100].sum() < 100
    assert not expected[100]


def test_base_distance_is_that_to_the_base_capsules(model):
    frames = {frame.name: frame for frame in model.pinocchio.frames}
    fixed = [capsule for capsule in model.description.capsules if frames[capsule.link].parentJoint == 0]
    assert fixed
    for point in np.random.default_rng(0).uniform(-0.6, 0.6, (200, 3)):
        expected = []
        for capsule in fixed:
            start, end = (frames[capsule.link].placement.act(np.array(x)) for x in (capsule.start, capsule.end))
            along = np.clip((point - start) @ (end - start) / max((end - start) @ (end - start), 1e-12), 0, 1)
            expected.append(np.linalg.norm(point - start - along * (end - start)) - capsule.radius)
        assert model.base_distance(point) == pytest.approx(min(expected), abs=1e-6)


@pytest.mark.slow
def test_box_distances_are_those_of_points_along_the_capsules(model):
    rng, frames = np.random.default_rng(0), {frame.name: i for i, frame in enumerate(model.pinocchio.frames)}
    boxes = Boxes(rng.uniform(-0.8, 0.8, (5, 3)), rng.uniform(0.02, 0.2, (5, 3)), rng.uniform(-np.pi, np.pi, 5))
    data = model.pinocchio.createData()
    for q in configurations(model, 100):
        pinocchio.framesForwardKinematics(model.pinocchio, data, q)
        nearest = np.full(len(boxes), np.inf)
        for capsule in model.description.capsules:
            start, end = (data.oMf[frames[capsule.link]].act(np.array(x)) for x in (capsule.start, capsule.end))
            along = boxes.distances(np.linspace(start, end, 1000))
            nearest = np.minimum(nearest, along.min(axis=0) - capsule.radius)
        found = model.box_distances(q, boxes)
        np.testing.assert_allclose(found[nearest > 0], nearest[nearest > 0], atol=5e-4)
        assert (found[nearest < -1e-3] < 0).all()


def test_within_limits_is_decided_joint_by_joint(model):
    lower, upper = model.limits.lower, model.limits.upper
    inside = np.random.default_rng(0).uniform(lower, upper, (5, 4, model.dof))
    assert model.within_limits(inside).all()
    assert model.within_limits(inside).shape == (5, 4)
    assert model.within_limits(np.array([lower, upper])).all()
    assert not model.within_limits(upper + 1e-9 * np.eye(model.dof)).any()
    assert not model.within_limits(lower - 1e-9 * np.eye(model.dof)).any()
    assert not model.within_limits(np.full(model.dof, np.nan))


def test_min_time_is_the_slowest_joints(model):
    goals = configurations(model, 21)
    start, goals = goals[0], goals[1:]
    times = travel_time(goals - start, 0.0, model.limits)
    np.testing.assert_allclose(model.min_time(start, goals), times.max(axis=1))
    np.testing.assert_allclose(model.min_time(start, goals), [model.min_time(start, goal) for goal in goals])
    np.testing.assert_array_equal(model.min_time(start, start), 0)
    assert (model.cruise_time(start, goals) <= model.min_time(start, goals)).all()
    middle = (start + goals) / 2
    halves = model.cruise_time(start, middle) + model.cruise_time(middle, goals)
    np.testing.assert_allclose(halves, model.cruise_time(start, goals))


def test_boxes_are_minded_where_they_stand_and_only_there(model):
    rng = np.random.default_rng(0)
    free = [q for q in configurations(model, 400) if model.is_free(q)][:50]
    assert free
    for q in free:
        tip = model.position(q)
        around_tip = Boxes(tip[None], np.full((1, 3), 0.08), rng.uniform(-3, 3, 1))
        far_away = Boxes(np.array([[3.0, 0, 0]]), np.full((1, 3), 0.08), np.zeros(1))
        assert model.among(far_away).is_free(q)
        assert model.is_free(q)
        touched = model.among(around_tip)
        assert len(touched.boxes) == 1
        if model.description.name.startswith("ur"):
            assert not touched.is_free(q)


def test_links_of_other_lengths_move_the_end_effector_by_their_segments():
    model = ArmModel("ur5")
    rng = np.random.default_rng(0)
    for q in rng.uniform(-3, 3, (10, 6)):
        errors, position = rng.uniform(-0.2, 0.2, 7), model.position(q)
        longer = model.with_lengths(errors)
        for place in (longer.position(q), longer.positions(q[None])[0], longer.segments(q).sum(axis=0)):
            np.testing.assert_allclose(place, (1 + errors) @ model.segments(q), atol=1e-12)
        np.testing.assert_array_equal(model.position(q), position)
