"""Image observations as 8-bit pictures, for videos and viewers; and how many of them a video has."""

from pathlib import Path
from typing import Any

import gymnasium
import imageio
import numpy as np
from numpy.typing import NDArray

MIN_SIDE = 4
"""Pixels; what is smaller is a matrix."""


def is_image(space: gymnasium.Space[Any]) -> bool:
    """Return whether a space has images: bounded, of shape (height, width) or (height, width, 1 or 3)."""
    if not isinstance(space, gymnasium.spaces.Box) or not space.is_bounded() or len(space.shape) not in (2, 3):
        return False
    return min(space.shape[:2]) >= MIN_SIDE and space.shape[2:] in ((), (1,), (3,))


def bounds_of(space: gymnasium.spaces.Box) -> tuple[float, float]:
    """Return the least and the largest value of an image."""
    return float(space.low.min()), float(space.high.max())


def pictures(images: NDArray[Any], low: float, high: float) -> NDArray[np.uint8]:
    """Images (n, height, width) or (n, height, width, 1 or 3) as pictures (n, height, width, 3).

    The bounds become 0 and 255, so depths get shades of grey, and pixels from 0 to 255 stay as they are.
    """
    shades = np.clip((images.astype(np.float32) - low) * (255 / (high - low)), 0, 255).round().astype(np.uint8)
    if shades.ndim == 3:
        shades = shades[..., None]
    return np.broadcast_to(shades, (*shades.shape[:3], 3))


def count_frames(video: Path) -> int:
    """Count a video's frames; 0 if it breaks off."""
    try:
        with imageio.get_reader(video) as reader:
            return int(reader.count_frames())
    except (OSError, RuntimeError, ValueError):  # whatever imageio raises then
        return 0
