import time

import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from armctl.core.errors import ConfigurationError, UnreachableTarget
from armctl.kinematics import ArmModel, Ik, IkOptions, closed_forms
from armctl.kinematics.ik import random_orientations
from armctl.robot_description import arm as arms

from ..arms import named_arm

TOLERANCE = IkOptions().tolerance
DISTINCT = IkOptions().distinct
FAR = np.array([3.0, 0.0, 0.5])
"""m; out of every arm's reach"""


@pytest.fixture(scope="module")
def ur5():
    return ArmModel("ur5")


@pytest.fixture
def ik(ur5):
    return Ik(ur5)


def numeric(model, options=None):
    """The solver without its closed form."""
    ik = Ik(model, options)
    ik.closed_form = ik._six_joints = None
    return ik


def panda():
    return ArmModel(named_arm("panda"))


def configurations(model, count, seed=0):
    return np.random.default_rng(seed).uniform(model.limits.lower, model.limits.upper, (count, model.dof))


def pose_residual(model, q, target):
    return np.linalg.norm(pinocchio.log6(pinocchio.SE3(model.pose(q)).actInv(pinocchio.SE3(target))).vector)


def position_residual(model, q, target):
    return np.linalg.norm(model.position(q) - target)


def apart(first, second):
    """Largest difference (rad) of any joint, whole turns left out."""
    return np.abs((first - second + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)


def check_solutions(model, result, seed, residual):
    """What holds for every result: solutions are true, allowed, different, and in order."""
    measured = [residual(q) for q in result.solutions]
    assert max(measured, default=0) <= TOLERANCE
    np.testing.assert_allclose(result.residuals, measured, atol=1e-9)
    assert model.within_limits(result.solutions).all()
    for i, q in enumerate(result.solutions):
        assert (apart(q, np.delete(result.solutions, i, axis=0)) > DISTINCT).all()
    assert (np.diff(np.abs(result.solutions - seed).max(axis=1)) >= 0).all()
    assert residual(result.closest) == pytest.approx(result.closest_residual, abs=1e-9)
    assert not result.reachable or np.array_equal(result.closest, result.q)


@pytest.mark.parametrize(("robot", "count"), [("ur5", 600), ("ur3", 300), ("ur10", 300)])
def test_closed_form_finds_the_configuration_that_made_the_pose(robot, count, sized):
    count = sized(count // 6, count)
    model = ArmModel(robot)
    ik = Ik(model)
    assert ik.closed_form
    for q, seed in zip(configurations(model, count), configurations(model, count, seed=1), strict=True):
        target = model.pose(q)
        result = ik.pose(target, seed)
        assert result.reachable
        assert apart(result.solutions, q).min() <= DISTINCT
        check_solutions(model, result, seed, lambda x, target=target: pose_residual(model, x, target))


def test_nearest_solution_to_the_configuration_itself_is_itself(ur5, ik):
    for q in configurations(ur5, 300):
        np.testing.assert_allclose(ik.pose(ur5.pose(q), q).q, q, atol=1e-5)


def test_count_takes_the_nearest(ur5, ik):
    target, seed = ur5.pose(ur5.home), np.zeros(6)
    every = ik.pose(target, seed).solutions
    assert len(every) == 8
    for count in range(1, 10):
        np.testing.assert_array_equal(ik.pose(target, seed, count).solutions, every[:count])


@pytest.mark.parametrize(("make", "count"), [(lambda: ArmModel("ur5"), 150), (panda, 60)])
def test_numeric_solver_solves_poses_from_anywhere(make, count):
    model = make()
    ik = numeric(model)
    assert ik._six_joints is None
    low, high = np.maximum(model.limits.lower, -np.pi), np.minimum(model.limits.upper, np.pi)
    solved = 0
    for q, seed in zip(configurations(model, count), configurations(model, count, seed=1), strict=True):
        target = model.pose(np.clip(q, low, high))
        result = ik.pose(target, seed)
        solved += result.reachable
        check_solutions(model, result, seed, lambda x, target=target: pose_residual(model, x, target))
    assert solved == count


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "on_floor"), [("xarm7", "xarm7"), ("panda", "panda"), ("panda_open", "panda")])
def test_arms_with_seven_joints_have_all_solutions_of_ssik(robot, on_floor):
    model, unmounted = ArmModel(robot), ArmModel(on_floor)
    ik, arm, missing = Ik(model), closed_forms._ssik(closed_forms.PREBUILT[model.description.name]), []
    assert getattr(closed_forms._branches(arm), "func", None) is closed_forms._compiled_branches
    at_home, on_mount = unmounted.pose(model.home), model.pose(model.home)
    from_tip, to_floor = np.linalg.inv(at_home) @ arm.fk(model.home), at_home @ np.linalg.inv(on_mount)
    for q in model.random_configurations(np.random.default_rng(0), 60):
        target = model.pose(q)
        result = ik.pose(target)
        assert result.residuals.max() < 1e-9
        check_solutions(model, result, model.home, lambda x, target=target: pose_residual(model, x, target))
        for expected in arm.solve(to_floor @ target @ from_tip, enumerate_windings=False):
            turns = (result.solutions - expected.q + np.pi) % (2 * np.pi) - np.pi
            missing.append(np.abs(turns).max(axis=1).min() > 5e-3)
    assert (len(missing) >= 60 * 8, np.mean(missing) <= 0.005) == (True, True)


def test_without_ssik_arms_with_seven_joints_are_solved_numerically(monkeypatch):
    monkeypatch.setattr(closed_forms, "_ssik", lambda name: None)
    model = ArmModel("panda")
    ik = Ik(model)
    assert ik.closed_form is None
    assert len(ik.pose(model.pose(model.home)).solutions) == 1


def test_numeric_solutions_are_among_those_of_the_closed_form(ur5, ik, sized):
    for q in configurations(ur5, sized(8, 20)):
        every = ik.pose(ur5.pose(q)).solutions
        for found in numeric(ur5).pose(ur5.pose(q), count=4).solutions:
            assert apart(every, found).min() <= DISTINCT


@pytest.mark.parametrize("make", [lambda: ArmModel("ur3"), lambda: ArmModel("ur10"), panda])
def test_positions_have_as_many_solutions_as_asked_for(make):
    model = make()
    ik = Ik(model)
    for q, seed in zip(configurations(model, 25), configurations(model, 25, seed=1), strict=True):
        target = model.position(q)
        for count in (1, 6):
            result = ik.position(target, seed, count)
            assert len(result.solutions) == count
            check_solutions(model, result, seed, lambda x, target=target: position_residual(model, x, target))


def test_arms_with_too_few_joints_for_a_pose_are_solved_by_position(tmp_path):
    links = "".join(
        f'<link name="l{i}"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>'
        "</inertial></link>"
        for i in range(4)
    )
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/><origin xyz="0 0 {z}"/>'
        f'<axis xyz="{axis}"/><limit lower="-3" upper="3" velocity="1" effort="1"/></joint>'
        for i, (axis, z) in enumerate([("0 0 1", 0.2), ("0 1 0", 0), ("0 1 0", 0.5)], 1)
    )
    hand = (
        '<link name="hand"/><joint name="j4" type="fixed"><parent link="l3"/><child link="hand"/>'
        '<origin xyz="0 0 .4"/></joint>'
    )
    urdf = tmp_path / "elbow.urdf"
    urdf.write_text(f'<robot name="elbow">{links}{joints}{hand}</robot>')
    model = ArmModel(urdf)
    for q in np.random.default_rng(0).uniform(-1.5, 1.5, (20, 3)):
        result = Ik(model).position(model.position(q), count=4)
        check_solutions(model, result, model.home, lambda x, q=q: position_residual(model, x, model.position(q)))
        assert apart(result.solutions, q).min() <= DISTINCT


SINGULAR = {
    "all zero": [0, 0, 0, 0, 0, 0],
    "stretched upwards": [0, -np.pi / 2, 0, -np.pi / 2, 0, 0],
    "wrist": [0.3, -1, 1.2, 0.4, 0, 0.7],
    "wrist turned": [0.3, -1, 1.2, 0.4, np.pi, 0.7],
    "elbow": [0.3, -1, 0, 0.4, 1, 0.7],
    "elbow folded": [0.3, -1, np.pi, 0.4, 1, 0.7],
    "half turns": [np.pi, -np.pi, 1, np.pi, 1, -np.pi],
    "limits": [2 * np.pi, -2 * np.pi, np.pi, 2 * np.pi, -2 * np.pi, 2 * np.pi],
}


@pytest.mark.parametrize("solver", [Ik, numeric])
@pytest.mark.parametrize("q", SINGULAR.values(), ids=SINGULAR)
def test_singular_poses_are_solved(ur5, q, solver):
    target = ur5.pose(np.array(q, dtype=float))
    for seed in (np.array(q, dtype=float), ur5.home, np.zeros(6)):
        result = solver(ur5).pose(target, seed)
        assert result.reachable
        check_solutions(ur5, result, seed, lambda x: pose_residual(ur5, x, target))


def unreachable_pose(model):
    target = model.pose(model.home).copy()
    target[:3, 3] = FAR
    return target


@pytest.mark.parametrize("solver", [Ik, numeric])
@pytest.mark.parametrize("kind", ["pose", "position"])
def test_out_of_reach_is_said_soon(ur5, solver, kind):
    ik = solver(ur5)
    target = unreachable_pose(ur5) if kind == "pose" else FAR
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        result = getattr(ik, kind)(target)
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 0.2
    assert not result.reachable
    assert result.solutions.shape == (0, 6)
    assert result.closest_residual > 1
    with pytest.raises(UnreachableTarget, match=f"{result.closest_residual:.3g}"):
        _ = result.q


@pytest.mark.parametrize("solver", [Ik, numeric])
def test_within_limits_counts_as_reachable_and_no_more(solver, tmp_path):
    path = arms.robot_data() / "ur_description/urdf/ur5_robot.urdf"
    narrow = tmp_path / "narrow.urdf"
    narrow.write_text(path.read_text().replace("6.28318530718", "0.5").replace("3.14159265359", "0.5"))
    model = ArmModel(arms.load_arm(narrow, tip="ee_link"))
    ik = solver(model)
    for q in configurations(model, 50):
        assert ik.pose(model.pose(q)).reachable
    outside = np.array([1.5, -1.5, 1.5, -1.5, -1.5, 0])
    result = ik.pose(model.pose(outside))
    check_solutions(model, result, model.home, lambda x: pose_residual(model, x, model.pose(outside)))
    assert not result.reachable


def altered(pose, change):
    pose = pose.copy()
    change(pose)
    return pose


def put(index, value):
    return lambda pose: pose.__setitem__(index, value)


ROTATION = (slice(0, 3), slice(0, 3))
MALFORMED = {
    "3x3": lambda pose: pose[:3, :3],
    "3x4": lambda pose: pose[:3],
    "stack": lambda pose: pose[None],
    "NaN in rotation": lambda pose: altered(pose, put((0, 0), np.nan)),
    "NaN in translation": lambda pose: altered(pose, put((0, 3), np.nan)),
    "infinite translation": lambda pose: altered(pose, put((1, 3), np.inf)),
    "scaled": lambda pose: altered(pose, put(ROTATION, 1.01 * pose[:3, :3])),
    "sheared": lambda pose: altered(pose, put((0, 1), pose[0, 1] + 0.1)),
    "reflection": lambda pose: altered(pose, put((slice(0, 3), 0), -pose[:3, 0])),
    "not homogeneous": lambda pose: altered(pose, put((3, 0), 1.0)),
    "transposed": lambda pose: pose.T,
}


@pytest.mark.parametrize("solver", [Ik, numeric])
@pytest.mark.parametrize("spoil", MALFORMED.values(), ids=MALFORMED)
def test_malformed_poses_are_refused(ur5, spoil, solver):
    with pytest.raises(ConfigurationError, match="pose"):
        solver(ur5).pose(spoil(ur5.pose(ur5.home)))


@pytest.mark.parametrize("target", [np.zeros(2), np.zeros((1, 3)), [0, 0, np.nan], [0, np.inf, 0]])
def test_malformed_positions_are_refused(ik, target):
    with pytest.raises(ConfigurationError, match="position"):
        ik.position(target)


@pytest.mark.parametrize("seed", [np.zeros(5), np.full(6, np.nan)])
@pytest.mark.parametrize("kind", ["pose", "position"])
def test_malformed_seeds_are_refused(ur5, ik, kind, seed):
    with pytest.raises(ConfigurationError, match="seed"):
        getattr(ik, kind)(getattr(ur5, kind)(ur5.home), seed)


@pytest.mark.parametrize("count", [0, -1])
@pytest.mark.parametrize("kind", ["pose", "position"])
def test_fewer_than_one_solution_cannot_be_asked_for(ur5, ik, kind, count):
    with pytest.raises(ConfigurationError, match="count"):
        getattr(ik, kind)(getattr(ur5, kind)(ur5.home), count=count)


@pytest.mark.parametrize("turns", [-5, -1, 1, 5])
@pytest.mark.parametrize("kind", ["pose", "position"])
def test_a_seed_beyond_the_limits_does_not_hide_the_solutions(ur5, ik, kind, turns):
    result = getattr(ik, kind)(getattr(ur5, kind)(ur5.home), ur5.home + 2 * np.pi * turns)
    assert result.reachable
    assert ur5.within_limits(result.q)


@pytest.mark.parametrize("solver", [Ik, numeric])
def test_same_arguments_same_answer(ur5, solver):
    used, q = solver(ur5), configurations(ur5, 8)
    for kind, extra in (("pose", ()), ("position", (4,))):
        targets = [getattr(ur5, kind)(x) for x in q]
        first = [getattr(used, kind)(target, ur5.home, *extra) for target in targets]
        for target, before in zip(targets[::-1], first[::-1], strict=True):
            for ik in (used, solver(ur5)):
                again = getattr(ik, kind)(target, ur5.home, *extra)
                np.testing.assert_array_equal(again.solutions, before.solutions)
                assert again.iterations == before.iterations


@pytest.mark.parametrize("solver", [Ik, numeric])
def test_arguments_are_left_as_they_were(ur5, solver):
    target, seed = ur5.pose(np.ones(6)), np.zeros(6)
    target_before, home_before = target.copy(), ur5.home.copy()
    solver(ur5).pose(target, seed)
    solver(ur5).position(target[:3, 3], seed, 3)
    np.testing.assert_array_equal(target, target_before)
    np.testing.assert_array_equal(seed, 0)
    np.testing.assert_array_equal(ur5.home, home_before)


@pytest.mark.parametrize("make", [lambda: ArmModel("ur5"), panda])
def test_free_configurations_are_free_and_there(make):
    model = make()
    ik = Ik(model)
    there = [model.position(q) for q in configurations(model, 60) if model.is_free(q)]
    found = [list(ik.free_configurations(position)) for position in there]
    for position, ways in zip(there, found, strict=True):
        for q in ways:
            assert model.is_free(q)
            assert model.within_limits(q)
            assert position_residual(model, q, position) <= TOLERANCE
    assert len(there) > 10
    assert np.mean([bool(ways) for ways in found]) >= 0.95
    for nowhere in (FAR, np.array([0.3, 0, -0.5])):  # the second lies below the floor
        assert not list(ik.free_configurations(nowhere))


def test_random_orientations_are_bit_for_bit_those_of_scipy():
    for seed, n in enumerate([1, 16, 65] * 20):
        expected = Rotation.random(n, rng=np.random.default_rng(seed)).as_matrix()
        assert np.array_equal(random_orientations(n, np.random.default_rng(seed)), expected)
