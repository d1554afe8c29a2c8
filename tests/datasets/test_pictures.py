import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from armctl.datasets.pictures import bounds_of, is_image, pictures


@pytest.mark.parametrize(
    ("space", "image"),
    [
        (Box(0, 255, (8, 6, 3), np.uint8), True),
        (Box(0, 255, (8, 6, 1), np.uint8), True),
        (Box(0, 10, (8, 6), np.float32), True),
        (Box(0, np.inf, (8, 6), np.float32), False),
        (Box(0, 10, (3, 3), np.float32), False),
        (Box(0, 10, (8, 6, 4), np.float32), False),
        (Box(0, 10, (48,), np.float32), False),
        (Discrete(3), False),
    ],
)
def test_what_is_an_image(space, image):
    assert is_image(space) is image


def test_pixels_stay_and_depths_become_shades():
    rng = np.random.default_rng(0)
    colours = rng.integers(256, size=(5, 8, 6, 3), dtype=np.uint8)
    np.testing.assert_array_equal(pictures(colours, *bounds_of(Box(0, 255, (8, 6, 3), np.uint8))), colours)
    depths = rng.uniform(0, 10, (5, 8, 6)).astype(np.float32)
    shades = pictures(depths, 0, 10)
    assert shades.shape == (5, 8, 6, 3)
    assert np.abs(shades[..., 0] / 25.5 - depths).max() <= 0.5 / 25.5 + 1e-5
    assert (pictures(np.array([[[-np.inf, 0, 10, np.inf]]]), 0, 10)[0, 0, :, 0] == [0, 0, 255, 255]).all()
