"""Features of a state of BARN's fields, without weights: scans of `Surroundings`, and shortest ways to the goal line.

Value iteration on a grid of the field gives the length of the shortest way from each cell (as in Tamar et al., "Value
iteration networks", NeurIPS 2016, there with weights). The network sees how much longer the way is from places around
the rover than from the best of them. Blocks are not turned.
"""

import math

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.rl.networks.bridge_scans import Surroundings
from armctl.tasks.bridge.fields import CELL, CELLS, FIELD_X, HALF_WIDTH
from armctl.tasks.bridge.observation import BLOCK, ROVER

CLOSED, NARROW = 0.3, 0.45
"""m: a cell whose centre is nearer to an obstacle is closed, or costs `DEAR` times as much."""
DEAR = 1.5
ROUND = ((1.0, 0.0), (0.92, 0.38), (0.7, 0.7), (0.38, 0.92), (0.0, 1.0))
"""Shares of a distance by which rectangles grow along and across: their union is a block with rounded corners."""
FREE = 4
"""Number of free rows of cells before and behind the field."""
FIRST_X = FIELD_X + (0.5 - FREE) * CELL
"""m: centres of the first row."""
SWEEPS = 60
"""Rounds of value iteration: a path has up to so many moves along a row or column, and as many diagonal ones."""
FARTHEST = 60.0
"""m: length of the way from a closed cell."""
CACHE_SIZE = 4000
"""Number of fields, of 4 kB each, whose lengths are kept."""
BEARINGS, RADII = 16, (0.3, 0.6, 1.2)
"""Number of directions, and distances (m), of the places around the rover."""
LONGEST = 2.0
"""m: what is longer by more than this is shown as this."""


class RouteFeatures(BaseFeaturesExtractor):
    """Features of a state of `armctl/BarnCross-v0`, with `blocks` blocks."""

    def __init__(self, observation_space: spaces.Box, blocks: int, **scans: float) -> None:
        surroundings = Surroundings(observation_space, blocks=blocks, **scans)
        super().__init__(observation_space, surroundings.features_dim + BEARINGS * len(RADII))
        self.surroundings = surroundings
        self._cache: dict[bytes, torch.Tensor] = {}
        self.register_buffer("x", FIRST_X + CELL * torch.arange(CELLS + 2 * FREE))
        self.register_buffer("ahead", (surroundings.goal_x - self.x)[:, None])
        self.register_buffer("is_last", (self.x == self.x[-1])[:, None])
        self.register_buffer("y", CELL * (torch.arange(CELLS - 2) + 0.5) - HALF_WIDTH)
        angles = 2 * math.pi / BEARINGS * torch.arange(BEARINGS)
        places = torch.tensor(RADII)[:, None, None] * torch.stack((angles.cos(), angles.sin()), dim=1)
        self.register_buffer("places", places.flatten(0, 1))
        self.register_buffer("beyond_sides", HALF_WIDTH - self.y.abs())

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (n, k) of states (n, m)."""
        x, y, cos, sin = observations[:, :4].split(1, dim=1)
        blocks = observations.split(self.surroundings.parts, dim=1)[ROVER]
        lengths = self._lengths_of(blocks.unflatten(1, (-1, BLOCK)))
        around = self._at(lengths, x + cos * self.places[:, 0] - sin * self.places[:, 1],
                          y + sin * self.places[:, 0] + cos * self.places[:, 1])  # fmt: skip
        shortest = around.amin(dim=1, keepdim=True)
        longer = (around - shortest).clamp(max=LONGEST)
        return torch.cat((self.surroundings(observations), longer), dim=1)

    def _lengths_of(self, blocks: torch.Tensor) -> torch.Tensor:
        """Return `lengths`; those of fields that were seen before are not computed again."""
        if torch.compiler.is_exporting():
            return self.lengths(blocks)
        fields = [values.tobytes() for values in blocks.numpy(force=True)]
        if len(self._cache) > CACHE_SIZE:
            self._cache = {}
        if missing := {field: i for i, field in enumerate(fields) if field not in self._cache}:
            self._cache |= zip(missing, self.lengths(blocks[list(missing.values())]), strict=True)
        return torch.stack([self._cache[field] for field in fields])

    def lengths(self, blocks: torch.Tensor) -> torch.Tensor:
        """Return the lengths (n, r, c) m of shortest paths to the goal line from each cell."""
        closed, narrow = self._nearer(blocks, CLOSED), self._nearer(blocks, NARROW)
        step = CELL * (1 + (DEAR - 1) * narrow) + FARTHEST * closed
        lengths = torch.where(self.is_last & (closed == 0), self.ahead, FARTHEST)
        for _ in range(SWEEPS):
            aside = _neighbour_minimum(lengths, across=1)
            straight = torch.minimum(aside, _neighbour_minimum(lengths, across=0))
            diagonal = _neighbour_minimum(aside, across=0)
            lengths = torch.minimum(lengths, torch.minimum(step + straight, math.sqrt(2) * step + diagonal))
        return lengths

    def _nearer(self, blocks: torch.Tensor, distance: float) -> torch.Tensor:
        """Return 1 for cells whose centres are nearer than a distance to a block or side, else 0."""
        counts = (self.beyond_sides < distance).float()
        for ahead, aside in ROUND:
            along = (self.x - blocks[..., :1]).abs() < blocks[..., 3:4] + ahead * distance
            across = (self.y - blocks[..., 1:2]).abs() < blocks[..., 4:5] + aside * distance
            counts = counts + along.float().transpose(1, 2) @ across.float()
        return (counts > 0.5).float()

    def _at(self, lengths: torch.Tensor, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """Return lengths (n, k) at places (n, k), interpolated; before and behind the field, straight ahead is free."""
        inside = x.clamp(FIRST_X, FIRST_X + (len(self.x) - 1) * CELL)
        i = ((inside - FIRST_X) / CELL).clamp(0.0, len(self.x) - 1.001)
        j = ((y + HALF_WIDTH) / CELL - 0.5).clamp(0.0, len(self.y) - 1.001)
        row, column = i.floor(), j.floor()
        flat, first = lengths.flatten(1), (row * len(self.y) + column).long()
        u, v = i - row, j - column
        near = (1 - v) * flat.gather(1, first) + v * flat.gather(1, first + 1)
        far = (1 - v) * flat.gather(1, first + len(self.y)) + v * flat.gather(1, first + len(self.y) + 1)
        return (1 - u) * near + u * far + inside - x


def _neighbour_minimum(lengths: torch.Tensor, across: int) -> torch.Tensor:
    """Return the lesser length of the two neighbours of each cell, in its row (across = 1) or its column (0)."""
    on, back = ((1, -1), (-1, 1)) if across else ((0, 0, 1, -1), (0, 0, -1, 1))
    pad = torch.nn.functional.pad
    return torch.minimum(pad(lengths, on, value=FARTHEST), pad(lengths, back, value=FARTHEST))
