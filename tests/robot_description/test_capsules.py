import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from armctl.robot_description.capsules import Capsule, enclosing_capsule

properties = settings(derandomize=True, max_examples=200)


@st.composite
def clouds(draw):
    """Points that fill a volume, a plane, a line, or one spot, anyhow turned and moved."""
    number = st.floats(-1, 1, allow_subnormal=False)
    points = draw(hnp.arrays(float, st.tuples(st.integers(1, 30), st.just(3)), elements=number))
    extent = draw(st.sampled_from([(1, 1, 1), (1, 0.01, 1), (1, 1, 0), (1, 0, 0), (0, 0, 0)]))
    turn = Rotation.from_rotvec(draw(hnp.arrays(float, 3, elements=number)))
    return turn.apply(points * extent) + draw(hnp.arrays(float, 3, elements=number))


# Here radius^2 and the farthest offset^2 round apart.
ROUNDING = np.array([[0.8, -0.9, -0.3], [-0.6, 0.2, 0.5], [0.7, -0.9, -0.1], [0.0, -0.1, -0.5], [-0.2, 0.1, 0.7]])


def distances(capsule, points):
    """Signed distance (m) of each point from the capsule's surface, above 0 outside."""
    start, axis = np.array(capsule.start), np.subtract(capsule.end, capsule.start)
    along = np.clip((points - start) @ axis / max(axis @ axis, 1e-300), 0, 1)
    return np.linalg.norm(points - start - along[:, None] * axis, axis=1) - capsule.radius


@pytest.mark.slow
@given(clouds())
@example(ROUNDING)
@properties
def test_no_vertex_is_outside(points):
    capsule = enclosing_capsule("link", points)
    assert np.isfinite([*capsule.start, *capsule.end, capsule.radius]).all()
    assert distances(capsule, points).max() <= 1e-9


@pytest.mark.slow
@given(clouds())
@example(ROUNDING)
@properties
def test_is_no_larger_than_the_sphere_around_the_bounding_box(points):
    radius = np.linalg.norm(np.ptp(points, axis=0)) / 2
    assert enclosing_capsule("link", points).volume <= 4 / 3 * np.pi * radius**3 * (1 + 1e-6) + 1e-12


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 0, 1), (1, 1, 0), (0.2, -0.5, 0.8)])
def test_finds_the_capsule_that_the_vertices_lie_on(axis):
    start = np.array([0.3, -0.1, 0.2])
    end = start + 0.5 * np.array(axis) / np.linalg.norm(axis)
    normals = np.random.default_rng(0).normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = np.where((normals @ axis)[:, None] > 0, end, start) + 0.06 * normals
    found = enclosing_capsule("link", points)
    assert found.volume == pytest.approx(Capsule("link", tuple(start), tuple(end), 0.06).volume, rel=0.05)
    ends = sorted([found.start, found.end], key=lambda point: np.linalg.norm(start - point))
    np.testing.assert_allclose(ends, [start, end], atol=0.005)


@pytest.mark.parametrize(("end", "radius"), [((0.1, 0.2, 0.3), 0.2), ((0.5, 0.2, 0.3), 0.2), ((0.1, 0.2, 2.3), 0.05)])
def test_volume_is_that_of_the_points_inside(end, radius):
    capsule = Capsule("link", (0.1, 0.2, 0.3), end, radius)
    low, high = np.minimum(capsule.start, end) - radius, np.maximum(capsule.start, end) + radius
    inside = distances(capsule, np.random.default_rng(0).uniform(low, high, (100_000, 3))) <= 0
    assert capsule.volume == pytest.approx(inside.mean() * np.prod(high - low), rel=0.02)
