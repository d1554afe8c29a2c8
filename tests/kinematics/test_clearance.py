import numpy as np
import pinocchio
import pytest

from armctl.kinematics import ArmModel
from armctl.kinematics.clearance import SPACING, Clearance, nearest_on_segments
from armctl.robot_description.collision_pairs import FLOOR
from armctl.scene import NO_BOXES, Boxes

STEP = 1e-6
"""rad, of finite differences"""
BOXES = Boxes(
    np.array([[0.5, 0.1, 0.3], [-0.4, 0.4, 0.5], [0.1, -0.6, 0.2]]),
    np.array([[0.1, 0.05, 0.2], [0.04, 0.15, 0.1], [0.2, 0.02, 0.1]]),
    np.array([0.3, -1.0, 2.0]),
)
ALL = 200
"""More pairs than there are."""


@pytest.fixture(scope="module", params=["ur3", "ur5", "ur10"])
def model(request):
    return ArmModel(request.param).among(BOXES)


@pytest.fixture(scope="module")
def postures(model):
    return np.random.default_rng(0).uniform(-np.pi, np.pi, (200, model.dof))


def distances_by_coal(model, q):
    """Least distance of all pairs that a controller can do something about."""
    data = model._shapes.createData()
    pinocchio.computeDistances(model.pinocchio, model.pinocchio.createData(), model._shapes, data, q)
    shapes, least = model._shapes.geometryObjects, np.inf
    for pair, result in zip(model._shapes.collisionPairs, data.distanceResults, strict=True):
        first, second = shapes[pair.first], shapes[pair.second]
        names = {first.name, second.name}
        stays = names == {"upper_arm_link", FLOOR} or (min(first.parentJoint, second.parentJoint) == 0 and
                max(first.parentJoint, second.parentJoint) == 1)  # fmt: skip
        if not stays:
            least = min(least, result.min_distance)
    return least


def test_distances_are_those_of_coal(model, postures):
    expected = np.array([distances_by_coal(model, q) for q in postures])
    found = Clearance(model).nearest(model.joint_frames(postures), BOXES, 4).least
    upper_arm = next(c for c in model.description.capsules if c.link == "upper_arm_link")
    elbow = model.joint_frames(postures)[:, 2, 2, 3]  # how high the far end of the upper arm is
    clear = (expected > 0) & (elbow > upper_arm.radius + expected)
    assert clear.sum() > 30
    off = found[clear] - expected[clear]
    assert off.min() > -1e-6
    assert off.max() < SPACING**2 / 8 / 0.03  # m: what half a gap is to the side, from 3 cm away
    assert ((found <= 0) >= (expected < -0.01)).all()


def test_gradients_are_those_of_finite_differences(model, postures):
    clearance, frames = Clearance(model), model.joint_frames
    distances, gradients = clearance.nearest(frames(postures), BOXES, ALL).rows
    there = np.isfinite(distances)
    assert 20 < there[0].sum() < ALL
    for j, step in enumerate(STEP * np.eye(model.dof)):
        after, before = (clearance.nearest(frames(postures + s), BOXES, ALL).rows[0] for s in (step, -step))
        slope = (after[there] - before[there]) / (2 * STEP)
        assert (
            np.quantile(np.abs(slope - gradients[..., j][there]), 0.999) < 1e-6
        )  # but where the nearest point changes


def test_the_nearest_pairs_are_chosen_and_missing_ones_are_harmless(model, postures):
    clearance, frames = Clearance(model), model.joint_frames(postures)
    everything = clearance.nearest(frames, BOXES, ALL)
    few = clearance.nearest(frames, BOXES, 3)
    np.testing.assert_allclose(np.sort(few.rows[0]), np.sort(everything.rows[0])[:, :3])
    np.testing.assert_allclose(few.least, few.rows[0].min(axis=1))
    missing = np.isinf(everything.rows[0])
    assert (everything.rows[1][missing] == 0).all()
    assert (clearance.nearest(frames, NO_BOXES, 3).least >= few.least).all()


def test_segments():
    rng = np.random.default_rng(0)
    a, b, c, d = rng.normal(size=(4, 300, 3))
    b[:20], d[10:30], d[30:40] = a[:20], c[10:30], c[30:40] + (b - a)[30:40]  # points, and parallels
    p, q = nearest_on_segments(a, b, c, d)
    s = np.linspace(0, 1, 41)
    grid = (a + s[:, None, None] * (b - a))[:, None] - (c + s[:, None, None] * (d - c))[None]
    assert (np.linalg.norm(p - q, axis=-1) <= np.linalg.norm(grid, axis=-1).min(axis=(0, 1)) + 1e-9).all()
