import coal
import numpy as np
import pinocchio
import pytest

from armctl.core.errors import ConfigurationError
from armctl.scene import NO_BOXES, Boxes


def random_boxes(rng, count=5, tilts=None):
    return Boxes(rng.uniform(-1, 1, (count, 3)), rng.uniform(0.02, 0.5, (count, 3)), rng.uniform(-4, 4, count), tilts)


@pytest.mark.parametrize("tilts", [None, np.array((0.0, 0.7, -2.0, 1.5, 3.0))])
def test_distances_are_those_of_coal_outside_and_negative_inside(tilts):
    rng = np.random.default_rng(0)
    boxes, points = random_boxes(rng, tilts=tilts), rng.uniform(-2, 2, (40, 10, 3))
    found = boxes.distances(points)
    assert found.shape == (40, 10, 5)
    for i, (centre, half_size, rotation) in enumerate(
        zip(boxes.centres, boxes.half_sizes, boxes.rotations, strict=True)
    ):
        box, placement = coal.Box(*(2 * half_size)), coal.Transform3s(rotation, centre)
        for point, distance in zip(points.reshape(-1, 3), found[..., i].ravel(), strict=True):
            at = coal.Transform3s(np.eye(3), point)
            wanted = coal.distance(box, placement, coal.Sphere(1e-9), at, coal.DistanceRequest(), coal.DistanceResult())
            assert np.sign(distance) == np.sign(wanted)
            if distance > 0:
                assert distance == pytest.approx(wanted, abs=1e-6)


def test_depth_is_to_the_nearest_face():
    box = Boxes(np.zeros((1, 3)), np.array([[1.0, 2.0, 3.0]]), np.array([np.pi / 2]))
    np.testing.assert_allclose(
        box.distances(np.array([[0, 0, 0], [1.9, 0, 0], [0, 0.9, 0], [0, 0, 3.5]]))[:, 0], [-1, -0.1, -0.1, 0.5]
    )


def test_a_box_is_turned_after_it_was_tilted():
    yaw, tilt = 0.4, np.pi / 4
    box = Boxes(np.zeros((1, 3)), np.ones((1, 3)), np.array((yaw,)), np.array((tilt,)))
    turned, tilted = (pinocchio.utils.rotate(axis, angle) for axis, angle in (("z", yaw), ("y", tilt)))
    np.testing.assert_allclose(box.rotations[0], turned @ tilted, atol=1e-12)
    np.testing.assert_array_equal(box.numbers, [[0, 0, 0, 1, 1, 1, yaw, tilt]])


@pytest.mark.parametrize("tilts", [np.zeros(2), np.full(1, np.nan)])
def test_unusable_tilts_are_refused(tilts):
    with pytest.raises(ConfigurationError, match="boxes"):
        Boxes(np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1), tilts)


def test_no_boxes_are_boxes_too():
    assert len(NO_BOXES) == 0
    assert NO_BOXES.distances(np.zeros((4, 3))).shape == (4, 0)
    assert NO_BOXES.rotations.shape == (0, 3, 3)


@pytest.mark.parametrize(
    ("centres", "half_sizes", "yaws"),
    [
        (np.zeros((2, 3)), np.ones((1, 3)), np.zeros(2)),
        (np.zeros((1, 2)), np.ones((1, 3)), np.zeros(1)),
        (np.full((1, 3), np.nan), np.ones((1, 3)), np.zeros(1)),
        (np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1)),
        (np.zeros((1, 3)), -np.ones((1, 3)), np.zeros(1)),
    ],
)
def test_unusable_boxes_are_refused(centres, half_sizes, yaws):
    with pytest.raises(ConfigurationError, match="boxes"):
        Boxes(centres, half_sizes, yaws)
