import coal
import numpy as np
import pinocchio
import pytest

from armctl.kernels.capsules import shares_on_segments
from armctl.kernels.clearance import point_on
from armctl.kinematics import ArmModel
from armctl.kinematics.clearance import NARROWEST, SPACING, Clearance
from armctl.robot_description import BUILTIN_ARMS, load_arm
from armctl.robot_description.arm import robot_data
from armctl.robot_description.collision_pairs import FLOOR, add_collision_pairs, capsule_geometry
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


def coal_geometry(model):
    """The arm's capsules, floor and boxes, and the pairs that can touch, for Pinocchio."""
    geometry = capsule_geometry(model.pinocchio, model.description.capsules)
    add_collision_pairs(geometry, model.description.collision_pairs)
    links = [i for i, shape in enumerate(geometry.geometryObjects) if shape.parentJoint > 0]
    for i, centre in enumerate(model.boxes.centres):
        placement = pinocchio.SE3(model.boxes.rotations[i], centre)
        box = pinocchio.GeometryObject(f"box {i}", 0, placement, coal.Box(*(2 * model.boxes.half_sizes[i])))
        at = geometry.addGeometryObject(box)
        for link in links:
            geometry.addCollisionPair(pinocchio.CollisionPair(link, at))
    return geometry


def elbow_height(model, q):
    """Height of the far end of the upper arm, m."""
    data = model.pinocchio.createData()
    pinocchio.forwardKinematics(model.pinocchio, data, q)
    return data.oMi[3].translation[2]


def distances_by_coal(model, q):
    """Least distance of all pairs that a controller can do something about."""
    geometry = coal_geometry(model)
    data = geometry.createData()
    pinocchio.computeDistances(model.pinocchio, model.pinocchio.createData(), geometry, data, q)
    shapes, least = geometry.geometryObjects, np.inf
    for pair, result in zip(geometry.collisionPairs, data.distanceResults, strict=True):
        first, second = shapes[pair.first], shapes[pair.second]
        names = {first.name, second.name}
        stays = names == {"upper_arm_link", FLOOR} or (min(first.parentJoint, second.parentJoint) == 0 and
                max(first.parentJoint, second.parentJoint) == 1)  # fmt: skip
        if not stays:
            least = min(least, result.min_distance)
    return least


@pytest.mark.slow
def test_distances_are_those_of_coal(model, postures):
    expected = np.array([distances_by_coal(model, q) for q in postures])
    found = Clearance(model).min_distances(postures)
    upper_arm = next(c for c in model.description.capsules if c.link == "upper_arm_link")
    elbow = np.array([elbow_height(model, q) for q in postures])
    clear = (expected > 0) & (elbow > upper_arm.radius + expected)
    assert clear.sum() > 30
    off = found[clear] - expected[clear]
    assert off.min() > -1e-6
    assert off.max() < SPACING**2 / 8 / 0.03  # m: what half a gap is to the side, from 3 cm away
    assert ((found <= 0) >= (expected < -0.01)).all()


def test_gradients_are_those_of_finite_differences(model, postures):
    clearance = Clearance(model)
    distances, gradients = clearance.nearest(postures, ALL)
    there = np.isfinite(distances)
    assert 20 < there[0].sum() < ALL
    for j, step in enumerate(STEP * np.eye(model.dof)):
        after, before = (clearance.nearest(postures + s, ALL)[0] for s in (step, -step))
        slope = (after[there] - before[there]) / (2 * STEP)
        assert (
            np.quantile(np.abs(slope - gradients[..., j][there]), 0.999) < 1e-6
        )  # but where the nearest point changes


def test_the_nearest_pairs_are_chosen_and_missing_ones_are_harmless(model, postures):
    clearance = Clearance(model)
    everything, gradients = clearance.nearest(postures, ALL)
    few = clearance.nearest(postures, 3)[0]
    np.testing.assert_allclose(np.sort(few), np.sort(everything)[:, :3])
    np.testing.assert_allclose(clearance.min_distances(postures), few.min(axis=1))
    missing = np.isinf(everything)
    assert (gradients[missing] == 0).all()
    assert (clearance.min_distances(postures, clearance.among(NO_BOXES)) >= few.min(axis=1)).all()


def test_segments():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 300, 2, 3))
    first[:20, 1], second[10:30, 1] = first[:20, 0], second[10:30, 0]  # points
    second[30:40, 1] = second[30:40, 0] + (first[:, 1] - first[:, 0])[30:40]  # parallels
    shares = np.linspace(0, 1, 41)[:, None]
    p, q = np.empty((2, 3))
    for one, other in zip(first, second, strict=True):
        for segment, share, point in zip((one, other), shares_on_segments(one, other), (p, q), strict=True):
            point_on(segment, share, point)
        grid = (one[0] + shares * (one[1] - one[0]))[:, None] - (other[0] + shares * (other[1] - other[0]))
        assert np.linalg.norm(p - q) <= np.linalg.norm(grid, axis=-1).min() + 1e-9


@pytest.mark.one_case
@pytest.mark.parametrize("name", ["ur3", "ur5", "ur10", "panda", "xarm7", "z1"])
def test_no_pair_has_to_keep_more_than_it_has_at_home(name):
    """A distance that counts as `margin` is at most what the pair has at home: else the arm would never be free."""
    builtin, margin = BUILTIN_ARMS[name], 0.03
    model = ArmModel(load_arm(robot_data() / builtin.urdf, tip=builtin.tip))
    true, scaled = Clearance(model), Clearance(model, margin)
    pairs = len(true.scene.pairs)
    at_home = true.nearest(model.home[None], pairs)[0][0]
    kept = margin * at_home / scaled.nearest(model.home[None], pairs)[0][0]
    assert (kept <= at_home).all()
    assert (kept <= margin + 1e-12).all()
    assert scaled.min_distances(model.home[None])[0] >= margin


def test_no_pair_has_to_keep_more_than_it_has_on_a_way(model):
    clearance, way = Clearance(model, 0.03), np.linspace(model.home, model.home + 0.3, 10)
    unscaled = Clearance(model).nearest(way, len(clearance.scene.pairs))[0].min(axis=0)
    clearance.scene = clearance.along(way)
    scaled = clearance.nearest(way, len(clearance.scene.pairs))[0].min(axis=0)
    wide_enough = unscaled >= NARROWEST
    assert (scaled[wide_enough] >= 0.03 - 1e-9).all()
