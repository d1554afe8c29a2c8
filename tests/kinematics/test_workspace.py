import numpy as np
import pytest
from scipy import stats

from armctl.core.errors import ConfigurationError
from armctl.kinematics import ArmModel, Ik, Workspace

from ..robot_description.small_arm import chain_of

AXES = {"X": "1 0 0", "Y": "0 1 0", "Z": "0 0 1"}

CLEARANCE = 0.05


@pytest.fixture(scope="module", params=["ur3", "ur5", "ur10"])
def workspace(request):
    return Workspace(ArmModel(request.param))


@pytest.fixture(scope="module")
def samples(workspace):
    rng = np.random.default_rng(0)
    return np.array([workspace.sample(rng, CLEARANCE) for _ in range(1000)])


@pytest.mark.slow
def test_samples_are_reachable_with_clearance(workspace, samples):
    ik = Ik(workspace.model)
    for position in samples:
        assert workspace.reachable(position)
        assert workspace.model.base_distance(position) >= CLEARANCE
    for position in samples[::10]:
        assert ik.position(position).reachable
    assert samples[:, 2].min() >= CLEARANCE
    assert np.linalg.norm(samples - workspace.centre, axis=1).max() <= workspace.radius


def test_nothing_is_reached_beyond_the_radius(workspace):
    model = workspace.model
    q = np.random.default_rng(1).uniform(model.limits.lower, model.limits.upper, (200_000, model.dof))
    assert np.linalg.norm(model.positions(q) - workspace.centre, axis=1).max() <= workspace.radius


def test_samples_are_spread_evenly(samples):
    """The arm turns all the way round, so equal sectors are equal volumes, and so are equal halves."""
    azimuth = np.arctan2(samples[:, 1], samples[:, 0])
    counts, _ = np.histogram(azimuth, bins=8, range=(-np.pi, np.pi))
    assert stats.chisquare(counts).pvalue > 1e-3
    for axis in (0, 1):
        assert stats.binomtest(int((samples[:, axis] > 0).sum()), len(samples)).pvalue > 1e-3


def test_samples_are_as_dense_in_the_middle_as_farther_out(workspace, samples):
    """Two shells of a quarter sphere, all of which is within reach, hold samples in proportion to their volumes."""
    distance = np.linalg.norm(samples - workspace.centre, axis=1)[samples[:, 2] > workspace.centre[2]]
    inner, middle, outer = 0.45 * workspace.radius, 0.6 * workspace.radius, 0.75 * workspace.radius
    near, far = ((distance > inner) & (distance < middle)).sum(), ((distance > middle) & (distance < outer)).sum()
    share = (middle**3 - inner**3) / (outer**3 - inner**3)
    assert stats.binomtest(int(near), int(near + far), share).pvalue > 1e-3


def test_same_generator_same_samples(workspace):
    again = Workspace(workspace.model)
    first, second = np.random.default_rng(5), np.random.default_rng(5)
    for _ in range(20):
        np.testing.assert_array_equal(workspace.sample(first, CLEARANCE), again.sample(second, CLEARANCE))
    assert (workspace.sample(np.random.default_rng(6), CLEARANCE) != again.sample(first, CLEARANCE)).all()


def test_clearance_is_kept_whatever_it_is(workspace):
    rng = np.random.default_rng(0)
    for clearance in (0.0, 0.2):
        for _ in range(50):
            position = workspace.sample(rng, clearance)
            assert position[2] >= clearance
            assert workspace.model.base_distance(position) >= clearance


@pytest.mark.parametrize("clearance", [1.3, 10.0])
def test_clearance_that_leaves_nothing_is_refused(clearance):
    model = ArmModel("ur5")
    with pytest.raises(ConfigurationError, match=f"{clearance} m"):
        Workspace(model).sample(np.random.default_rng(0), clearance, attempts=50)


@pytest.mark.parametrize("position", [[5, 0, 0.5], [0, 0, -0.5], [0.3, 0.3, -0.01], [np.nan, 0, 0.5], [np.inf, 0, 0]])
def test_unreachable_positions(workspace, position):
    assert not workspace.reachable(np.array(position, dtype=float))


def test_where_a_free_configuration_is_can_be_reached(workspace):
    model = workspace.model
    low, high = np.maximum(model.limits.lower, -np.pi), np.minimum(model.limits.upper, np.pi)
    free = [q for q in np.random.default_rng(0).uniform(low, high, (1500, model.dof)) if model.is_free(q)]
    assert len(free) > 300
    assert np.mean([workspace.reachable(model.position(q)) for q in free]) >= 0.99


@pytest.mark.one_case
def test_tolerance_reaches_just_beyond_the_edge(workspace):
    for direction in np.random.default_rng(0).normal(size=(10, 3)) * [1, 1, 0.3] + [0, 0, 0.5]:
        ray = direction / np.linalg.norm(direction)
        far = workspace.radius
        while not workspace.reachable(workspace.centre + far * ray):
            far -= 0.01
        beyond = workspace.centre + (far + 0.03) * ray
        assert not workspace.reachable(beyond)
        assert not workspace.reachable(beyond, tolerance=0.005)
        assert workspace.reachable(beyond, tolerance=0.05)


def test_tolerance_adds_and_never_takes_away(workspace, samples):
    assert all(workspace.reachable(position, tolerance) for position in samples[:50] for tolerance in (0.01, 0.1))


ODD_ARMS = {
    "two joints about one axis": "ZYYYZZ",
    "two axes for six joints": "ZYYYYY",
    "five": "ZYYYX",
    "four": "ZYYX",
    "three": "ZYY",
    "in a plane": "YYY",
    "on a sphere": "ZY",
    "on a circle": "Y",
}


@pytest.mark.one_case
@pytest.mark.parametrize("axes", ODD_ARMS.values(), ids=ODD_ARMS)
def test_an_arm_of_any_joints_reaches_where_it_has_been(tmp_path, axes):
    path = tmp_path / "arm.urdf"
    path.write_text(chain_of([AXES[axis] for axis in axes], length=0.2))
    model = ArmModel(path)
    workspace, rng = Workspace(model), np.random.default_rng(1)
    q = model.random_configurations(rng, 200)
    positions = model.positions(q[model.are_free(q)][:20])
    assert np.mean([workspace.reachable(position) for position in positions]) >= 0.9
    drawn = np.array([workspace.sample(rng, 0.02) for _ in range(3)])
    assert all(workspace.reachable(position, 1e-6) for position in drawn)
    assert (drawn[:, 2] >= 0.02).all()
    assert not workspace.reachable(model.shoulder + np.array([0, 0, 2 * workspace.radius]))


def test_near_a_thin_workspace_is_within_reach_and_beyond_the_tolerance_is_not(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(chain_of([AXES["Y"]] * 3, length=0.2))
    workspace = Workspace(ArmModel(path))
    inside = workspace.sample(np.random.default_rng(0), 0.02)
    assert workspace.is_thin
    assert workspace.reachable(inside + np.array([0, 0.04, 0]), 0.05)
    assert not workspace.reachable(inside + np.array([0, 0.06, 0]), 0.05)
