"""A depth image of the bridge, reduced to how far the way is free in each of its columns.

Points that stand out of the deck are obstacles; where the camera sees far below the deck, there is a hole in it. The
rover nods by up to eight degrees when it speeds up or brakes, so the camera's pitch is found first, from two rows of
the image that show the deck just before the wheels.
"""

import math
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.rl.networks.bridge_scans import nearness

MAX_NOD = 0.25
"""Largest change of how far the camera looks down, against rest, rad."""
MIN_OBSTACLE_HEIGHT, MAX_OBSTACLE_HEIGHT = 0.12, 0.75
"""Heights above the deck between which what is seen is an obstacle, m."""
HOLE_HEIGHT = -0.5
"""Height below which what is seen is a hole, m."""
MAX_RISE = -0.12
"""Rise of a ray per m of depth above which no hole is looked for."""
DECK_ROWS = (31 / 32, 24 / 32)
"""Shares of the image's height at which the deck is seen before the wheels."""


class ColumnRanges(torch.nn.Module):
    """Map from a dict of `image` (n, height, width), m deep, and `motion` to one of `ranges` (n, width) and `motion`.

    Ranges are horizontal distances from the camera, m, at most `farthest`. `field_of_view` is the image's horizontal
    one, degrees; `pitch` is how far the camera looks down at rest, rad. A dict that has `ranges` already
    stays as it is.
    """

    def __init__(self, observation_space: spaces.Dict, field_of_view: float, farthest: float, pitch: float) -> None:
        super().__init__()
        self.farthest = farthest
        self.min_tangent, self.max_tangent = (math.tan(pitch + nod) for nod in (-MAX_NOD, MAX_NOD))
        if "ranges" in observation_space.spaces:
            return
        height, width = observation_space["image"].shape or (1, 1)
        pixel = 2 * math.tan(math.radians(field_of_view) / 2) / width
        up = (height / 2 - torch.arange(height) - 0.5) * pixel
        sideways = (width / 2 - torch.arange(width) - 0.5) * pixel
        self.rows = [min(int(share * height), height - 1) for share in DECK_ROWS]
        self.register_buffer("up", up[:, None])
        self.register_buffer("left", sideways[None])
        self.lower, self.upper = (float(up[row]) for row in self.rows)

    def forward(self, observation: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Return ranges and motions."""
        if "ranges" in observation:
            return observation
        depths = observation["image"]
        cos, sin, height = self._pose(depths)
        rise, ahead = self.up * cos - sin, cos + self.up * sin
        reach = (ahead * ahead + self.left * self.left).sqrt()
        z = height + rise * depths
        far = torch.full_like(z, self.farthest)
        obstacle = torch.where((z > MIN_OBSTACLE_HEIGHT) & (z < MAX_OBSTACLE_HEIGHT), depths * reach, far)
        steep = rise.clamp(max=MAX_RISE)
        hole = torch.where((z < HOLE_HEIGHT) & (rise < MAX_RISE), -height / steep * reach, far)
        ranges = torch.minimum(obstacle, hole).amin(dim=1).clamp(0.0, self.farthest)
        return {"motion": observation["motion"], "ranges": ranges}

    def _pose(self, depths: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return cosine and sine of the camera's pitch, and its height (m), (n, 1, 1), by the deck's depth."""
        lower, upper = (depths[:, row].amax(dim=1)[:, None, None] for row in self.rows)
        tangent = (upper * self.upper - lower * self.lower) / (upper - lower).clamp(min=0.02)
        tangent = tangent.clamp(self.min_tangent, self.max_tangent)
        cos = 1 / (1 + tangent * tangent).sqrt()
        sin = tangent * cos
        return cos, sin, lower * (sin - self.lower * cos)


class NearnessFeatures(BaseFeaturesExtractor):
    """The nearness of all ranges, and the rover's own motion."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        ranges = observation_space["ranges"].shape or (0,)
        super().__init__(observation_space, ranges[0] + 3)

    def forward(self, observations: Any) -> torch.Tensor:
        """Return features (n, width + 3) of ranges (n, width) and motions (n, 3)."""
        return torch.cat((nearness(observations["ranges"]), observations["motion"]), dim=1)
