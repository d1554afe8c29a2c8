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
MIN_DEPTH = 0.05
"""Depth below which a pixel is lost, m."""
IN_SIGHT = 0.97
"""Share of the camera's range from which on nothing is in sight."""
HORIZON, FLOOR = 0.25, (-0.7, -0.12)
"""Rises, m per m ahead, of the rows that see obstacles, up or down, and of those that see the floor."""
FLOOR_GATES = (0.25, 0.15, 0.12)
"""Largest distances from the floor, m, of pixels to which it is fitted, one after the other."""


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
        up, sideways = _rays(observation_space, field_of_view)
        self.rows = [min(int(share * len(up)), len(up) - 1) for share in DECK_ROWS]
        self.register_buffer("up", up)
        self.register_buffer("left", sideways)
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


class FloorRanges(torch.nn.Module):
    """The same map as `ColumnRanges`, by averages that noise of each pixel hardly changes.

    The pitch is the mean of the angles at which the pixels of the lower rows see the floor, after three fits with ever
    narrower gates. An obstacle's distance is the lower quartile over the rows about the horizon, so that columns of a
    Jersey barrier, which leans, end near its foot. `above` is the camera's height at rest, m; it rises by `lift` m for
    each rad that the rover's nose rises. A lost image, which is black, has ranges of 0.
    """

    def __init__(
        self, observation_space: spaces.Dict, field_of_view: float, farthest: float, pitch: float, above: float,
        lift: float,
    ) -> None:  # fmt: skip
        super().__init__()
        self.farthest, self.pitch, self.above, self.lift = farthest, pitch, above, lift
        if "ranges" in observation_space.spaces:
            return
        up, sideways = _rays(observation_space, field_of_view)
        self.register_buffer("up", up)
        self.register_buffer("left", sideways)

    def forward(self, observation: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Return ranges and motions."""
        if "ranges" in observation:
            return observation
        depths = observation["image"]
        measured = depths > MIN_DEPTH
        rise, ahead, height = self._pose(depths, measured)
        reach, z = (ahead * ahead + self.left * self.left).sqrt(), height + rise * depths
        far = torch.full_like(z, self.farthest)
        standing = (z > MIN_OBSTACLE_HEIGHT) & (z < MAX_OBSTACLE_HEIGHT) & ((rise / ahead).abs() < HORIZON)
        standing &= measured & (depths < IN_SIGHT * self.farthest)
        nearest_first = torch.where(standing, depths * reach, far).topk(len(self.up) // 4 + 1, dim=1, largest=False)
        quartile = (self._column_sums(standing) / 4).floor().long()
        obstacle = nearest_first.values.gather(1, quartile)[:, 0]
        is_hole = measured & (z < HOLE_HEIGHT) & (rise < MAX_RISE)
        hole = torch.where(is_hole, -height / rise.clamp(max=MAX_RISE) * reach, far).amin(dim=1)
        ranges = torch.minimum(obstacle, hole).clamp(0.0, self.farthest)
        return {"motion": observation["motion"], "ranges": ranges * measured.any(dim=2).any(dim=1, keepdim=True)}

    def _pose(self, depths: torch.Tensor, measured: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return rise and advance of rows per m of depth (n, height, 1), and the camera's height (n, 1, 1), m."""
        pitch = torch.full_like(depths[:, :1, :1], self.pitch)
        for gate in FLOOR_GATES:
            rise, ahead, height = self._rays_at(pitch)
            slope, z = rise / ahead, height + rise * depths
            floor = measured & (slope > FLOOR[0]) & (slope < FLOOR[1]) & (z.abs() < gate)
            turns = self._column_sums(torch.where(floor, z * slope / -height, torch.zeros_like(z)))
            columns = torch.ones_like(self.left).mT
            turn = turns @ columns / (self._column_sums(floor) @ columns).clamp(min=1)
            pitch = (pitch + turn).clamp(self.pitch - MAX_NOD, self.pitch + MAX_NOD)
        return self._rays_at(pitch)

    def _column_sums(self, values: torch.Tensor) -> torch.Tensor:
        """Return the sum of each column (n, 1, width): a product, as graphs with sums run one world at a time."""
        return torch.ones_like(self.up).mT @ values.float()

    def _rays_at(self, pitch: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        cos, sin = pitch.cos(), pitch.sin()
        height = self.above + self.lift * (self.pitch - pitch).clamp(min=0.0)
        return self.up * cos - sin, cos + self.up * sin, height


def _rays(observation_space: spaces.Dict, field_of_view: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return offsets at a depth of 1: of the rows' rays upwards (height, 1), of the columns' to the left (1, width)."""
    height, width = observation_space["image"].shape or (1, 1)
    pixel = 2 * math.tan(math.radians(field_of_view) / 2) / width
    up = (height / 2 - torch.arange(height) - 0.5) * pixel
    return up[:, None], ((width / 2 - torch.arange(width) - 0.5) * pixel)[None]


class NearnessFeatures(BaseFeaturesExtractor):
    """The nearness of all ranges, and the rover's own motion."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        ranges = observation_space["ranges"].shape or (0,)
        super().__init__(observation_space, ranges[0] + 3)

    def forward(self, observations: Any) -> torch.Tensor:
        """Return features (n, width + 3) of ranges (n, width) and motions (n, 3)."""
        return torch.cat((nearness(observations["ranges"]), observations["motion"]), dim=1)


class HeldNearnessFeatures(NearnessFeatures):
    """The same, for a network that remembers the last image while images are lost."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        super().__init__(observation_space)
        self.image_size = self.features_dim - 3
