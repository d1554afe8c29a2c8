"""Each kernel computes what its reference in NumPy does."""

from typing import Any

import numpy as np
import pinocchio
import pytest

from armctl.kernels import arm, capsules, drives, ik, reach, reach_mpc, target_distance
from armctl.kernels.clearance import ScaledScene
from armctl.kernels.edges import PAIR
from armctl.kinematics import ArmModel, MinimumTimePose
from armctl.kinematics.records import box_records
from armctl.robot_description.joint_profiles import TICK, fly_by_setpoint, trapezoidal_displacement
from armctl.scene import Boxes

from . import joint_profiles, reference

CLOSE: dict[str, Any] = {"rtol": 0, "atol": 1e-12}
PERIOD, HORIZON = 0.04, 20


@pytest.fixture(scope="module", params=["ur5", "panda"])
def model(request):
    return ArmModel(request.param)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def configurations(model, rng, count):
    return rng.uniform(np.maximum(model.limits.lower, -3), np.minimum(model.limits.upper, 3), (count, model.dof))


def test_frames_are_pinocchios(model, rng):
    rotations, origins = np.empty((model.dof, 3, 3)), np.empty((model.dof, 3))
    data = model.pinocchio.createData()
    for q in configurations(model, rng, 50):
        arm.forward(model.joints, q, rotations, origins)
        pinocchio.forwardKinematics(model.pinocchio, data, q)
        for placement, rotation, origin in zip(list(data.oMi)[1:], rotations, origins, strict=True):
            np.testing.assert_allclose(placement.rotation, rotation, **CLOSE)
            np.testing.assert_allclose(placement.translation, origin, **CLOSE)


def test_drives(model, rng):
    limits, n = model.limits, 40
    positions = rng.uniform(limits.lower, limits.upper, (n, model.dof))
    commands = positions + rng.uniform(-0.4, 0.4, positions.shape)
    commands[: n // 2] = np.clip(positions[: n // 2], limits.lower, limits.upper)
    initial = commands.copy()
    for to_positions in (True, False):
        velocities = rng.uniform(-1, 1, positions.shape) * limits.velocity
        wanted = rng.uniform(limits.lower, limits.upper, positions.shape)
        waiting = np.clip(commands, positions - 0.3, positions + 0.3)
        towards = joint_profiles.towards(wanted, waiting, limits) if to_positions else wanted
        expected = joint_profiles.limited(towards, waiting, velocities, limits)
        for i in range(n):
            given = np.tile(velocities[i], 2)
            drives.drive_joints(limits.drives, wanted[i], to_positions, positions[i], commands[i], given, 0.3, TICK)
            np.testing.assert_allclose(given, np.tile(expected[i], 2), **CLOSE)
        np.testing.assert_allclose(commands, waiting, **CLOSE)
        commands[:] = initial


def test_times_and_profiles(model, rng):
    limits, start = model.limits, model.home
    goals, velocity = configurations(model, rng, 60), rng.uniform(-1, 1, model.dof) * model.limits.velocity
    times = np.empty(len(goals))
    drives.min_times(limits.drives, start, velocity, goals, times)
    expected = joint_profiles.travel_time(goals - start, velocity, limits).max(axis=1)
    np.testing.assert_allclose(times, expected, **CLOSE)
    clock = np.linspace(0, 2, 50)
    for goal, time in zip(goals[:10], times, strict=False):
        expected = joint_profiles.trapezoidal_displacement(clock[:, None], goal - start, limits)
        np.testing.assert_allclose(trapezoidal_displacement(clock, goal - start, limits), expected, **CLOSE)
        expected = joint_profiles.fly_by_setpoint(start, goal, time, limits)
        np.testing.assert_allclose(fly_by_setpoint(start, goal, time, limits), expected, **CLOSE)


def test_motion_into_a_sphere(model, rng):
    q, starts = configurations(model, rng, 30), configurations(model, rng, 30)
    centres = model.positions(configurations(model, rng, 30))
    velocities = rng.uniform(-1, 1, q.shape) * model.limits.velocity
    found = q.copy()
    reach.approach(model.joints, found, centres, 5)
    expected = [reference.approach(model, *one, 5) for one in zip(q, centres, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)  # five steps magnify the last bits
    step = np.empty(model.dof)
    for one in zip(q, starts, centres, velocities, strict=True):
        at, start, centre, velocity = one
        time, distance = reach.step_into_sphere(
            model.joints, at, reach.Start(start, velocity), centre, 0.05, 0.1, arm.workspace(model.joints), step
        )
        expected, *others = reference.step_into_sphere(model, at, start, centre, 0.05, velocity, 0.1)
        np.testing.assert_allclose(step, expected, **CLOSE)
        np.testing.assert_allclose((time, distance), others, **CLOSE)


def test_refinement_keeps_the_earliest_of_its_steps_that_is_inside(model, rng):
    q, start, velocity = configurations(model, rng, 20), model.home, np.zeros(model.dof)
    centre, radius, steps = model.position(configurations(model, rng, 1)[0]), 0.1, np.geomspace(0.2, 0.01, 8)
    reach.approach(model.joints, q, np.tile(centre, (len(q), 1)), 8)
    inside = []
    for at in np.clip(q, model.limits.lower, model.limits.upper):
        least = [np.inf]
        for max_step in steps:
            step, time, distance = reference.step_into_sphere(model, at, start, centre, radius, velocity, max_step)
            least += [time] if distance <= radius else []
            at = at + step
        inside.append(min(least))
    times, many = np.empty(len(q)), np.tile
    reach.refine(
        model.joints, q, many(start, (20, 1)), many(centre, (20, 1)), radius, many(velocity, (20, 1)), steps, times
    )
    assert np.isfinite(times).sum() > 10
    np.testing.assert_allclose(times, inside, rtol=0, atol=1e-9)


def test_min_times_into_spheres(model, rng):
    m, g = 12, 5
    q, centres = configurations(model, rng, m), model.positions(configurations(model, rng, m))
    centres[0] = model.position(q[0])
    velocities = rng.uniform(-1, 1, q.shape) * model.limits.velocity
    goals, excess = configurations(model, rng, m * g).reshape(m, g, -1), rng.uniform(0, 0.1, (m, g))
    times, max_steps = np.empty(m), np.array((0.2, 0.05, 0.0))
    spheres = reach.Spheres(centres, goals, excess)
    reach.min_times_into_spheres(model.joints, q, velocities, spheres, 0.05, 3, max_steps, times)
    expected = [
        reference.min_time_into_sphere(model, *one, 0.05, reach.TIP_SPEED, reach.AIM, 3, max_steps)
        for one in zip(q, velocities, centres, goals, excess, strict=True)
    ]
    assert times[0] == 0
    np.testing.assert_allclose(times, expected, rtol=0, atol=1e-9)


def test_segments_and_boxes(rng):
    boxes = Boxes(rng.uniform(-1, 1, (60, 3)), rng.uniform(0.02, 0.5, (60, 3)), rng.uniform(-3, 3, 60))
    segments = rng.uniform(-1, 1, (60, 2, 3))
    segments[:5, 1] = segments[:5, 0]
    segments[5:10, 1] = segments[5:10, 0] + boxes.rotations[5:10, :, 1]
    for segment, box, rotation in zip(segments, box_records(boxes), boxes.rotations, strict=True):
        found = capsules.segment_box_distance(segment, box)
        expected = reference.segment_to_box(segment, box["centre"], box["half_size"], rotation)
        assert found <= expected + 1e-12
        assert found == pytest.approx(expected, abs=1e-6), "the reference samples the segment"


def test_rigid_poses(rng):
    for _ in range(60):
        pose = pinocchio.SE3.Random().homogeneous
        assert ik.is_rigid(pose, 1e-6)
        bad = pose.copy()
        bad[rng.integers(3), rng.integers(3)] += 0.01
        assert not ik.is_rigid(bad, 1e-6)
        assert not ik.is_rigid(pose * np.nan, 1e-6)
        bad = pose.copy()
        bad[:3, 0] *= -1
        assert not ik.is_rigid(bad, 1e-6)


def test_turns(model, rng):
    found = np.empty(model.dof)
    for q, seed in zip(rng.uniform(-9, 9, (50, model.dof)), configurations(model, rng, 50), strict=True):
        reach.nearest_turn(model.joints, q, seed, found)
        expected = reference.turns_near(q, seed, model.limits.lower, model.limits.upper)
        np.testing.assert_allclose(found, expected, **CLOSE)


def test_motions_of_the_controller(model, rng):
    limits, shape = model.limits, (HORIZON + 1, model.dof)
    positions, velocities, accelerations = np.empty(shape), np.empty(shape), np.empty((HORIZON, model.dof))
    stopped = 0
    for _ in range(40):
        q, v = rng.uniform(0.9 * limits.lower, 0.9 * limits.upper), rng.uniform(-0.5, 0.5, model.dof) * limits.velocity
        wanted = np.vstack((v, rng.uniform(-2, 2, (HORIZON, model.dof)) * limits.velocity))
        reach_mpc.project(limits.drives, PERIOD, q, v, wanted, positions, velocities, accelerations)
        expected = reference.projected(limits, PERIOD, q, v, wanted)
        np.testing.assert_allclose(velocities, expected, **CLOSE)
        for found, one in zip((positions, accelerations), reference.rolled_out(PERIOD, q, expected), strict=True):
            np.testing.assert_allclose(found, one, rtol=1e-12, atol=1e-11)
        stopped += ((positions == limits.lower) | (positions > 0.99 * limits.upper)).any()
        goal = configurations(model, rng, 1)[0]
        reach_mpc.go_straight(limits.drives, PERIOD, q, v, goal, velocities)
        np.testing.assert_allclose(velocities, reference.straight(limits, PERIOD, HORIZON, q, v, goal), **CLOSE)
        reach_mpc.brake(limits.drives, PERIOD, v, velocities)
        speeds = np.maximum(np.abs(v) - np.arange(HORIZON + 1)[:, None] * limits.acceleration * PERIOD, 0)
        np.testing.assert_allclose(velocities, np.copysign(speeds, v), **CLOSE)
        errors, weights = rng.normal(size=(HORIZON, 3)), (1e-3, 1e-4, 1e-5)
        found = reach_mpc.cost_of(weights, goal, positions, velocities, accelerations, errors)
        expected = reference.cost(weights, goal, positions, velocities, accelerations, errors)
        assert found == pytest.approx(expected, rel=1e-12)
    assert stopped


@pytest.mark.parametrize("exact", [True, False])
def test_quadratic_models(model, rng, exact):
    q, dof = configurations(model, rng, HORIZON), model.dof
    targets, least = rng.normal(size=(HORIZON, 3)), np.full(HORIZON, np.inf)
    knots = reach_mpc.Knots(q, np.empty((HORIZON, 3)), *np.empty((2, HORIZON, dof, 3)))
    _, errors, axes, gradients = knots
    samples = np.ones(len(model.links), dtype=int)
    scene = ScaledScene(
        model.joints, model.links, np.zeros(0, dtype=PAIR), box_records(model.boxes), samples, np.ones(0)
    )
    reach_mpc.evaluate_knots(scene, targets, knots, least)
    np.testing.assert_allclose(errors, [model.position(at) - one for at, one in zip(q, targets, strict=True)], **CLOSE)
    jacobians = np.array([model.jacobian(at) for at in q])
    np.testing.assert_allclose(gradients.swapaxes(1, 2), jacobians[:, :3], **CLOSE)
    np.testing.assert_allclose(axes.swapaxes(1, 2), jacobians[:, 3:], **CLOSE)
    hessians, slopes = np.empty((HORIZON, dof, dof)), np.empty((HORIZON, dof))
    reach_mpc.quadratic_model(knots, exact, 1e-3, model.home, hessians, slopes)
    expected = reference.quadratic_model(q, errors, axes, gradients, exact, 1e-3, model.home)
    np.testing.assert_allclose(hessians, expected[0], rtol=1e-10, atol=1e-11)
    np.testing.assert_allclose(slopes, expected[1], rtol=1e-10, atol=1e-10)


def test_quadratic_models_of_poses(model, rng):
    """Errors are those of places; gradients and the Hessian near the target are those of finite differences."""
    search, dof, step = MinimumTimePose(model, 0.1), model.dof, 1e-5
    q = configurations(model, rng, 3)
    targets = np.array([search.place(at + 0.1 * rng.normal(size=dof)) for at in q])
    scene = ScaledScene(
        model.joints, model.links, np.zeros(0, dtype=PAIR), box_records(model.boxes),
        np.ones(len(model.links), dtype=int), np.ones(0),
    )  # fmt: skip

    def evaluated(at):
        knots = reach_mpc.Knots(at, np.empty((3, 12)), np.empty((3, dof, 3)), np.empty((3, dof, 12)))
        reach_mpc.evaluate_knots(scene, targets, knots, np.full(3, np.inf))
        return knots

    knots = evaluated(q)
    np.testing.assert_allclose(knots.errors, [search.place(at) for at in q] - targets, **CLOSE)
    ways = step * np.eye(dof)
    differences = [(evaluated(q + way).errors - evaluated(q - way).errors) / (2 * step) for way in ways]
    np.testing.assert_allclose(knots.gradients, np.transpose(differences, (1, 0, 2)), atol=1e-8)
    hessian = np.empty((dof, dof))
    for k in range(3):
        reach_mpc.squared_error_hessian(knots.gradients[k], knots.axes[k], knots.errors[k], True, hessian)
        slopes = [
            [(after.gradients[k] @ after.errors[k]) for after in (evaluated(q + way), evaluated(q - way))]
            for way in ways
        ]
        expected = [(ahead - behind) / (2 * step) for ahead, behind in slopes]
        np.testing.assert_allclose(hessian, expected, atol=1e-8)


def test_distances_are_rounded_as_they_are_observed(rng):
    positions, targets = rng.normal(size=(2, 50, 3))
    found = np.empty(50)
    target_distance.distances_as_observed(positions, targets, found)
    seen = [np.float32(numbers).astype(float) for numbers in (positions, targets)]
    np.testing.assert_allclose(found, np.linalg.norm(seen[1] - seen[0], axis=1), **CLOSE)
