"""Path lengths from all over a bridge to the goal line, around the blocks, on a lattice.

Every lattice point is joined to 16 others, so paths are at most 2.8 % longer than the shortest, and 1 % on average. A
point without clearance gets the length of the nearest point that has it, plus a penalty.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from armctl.core.arrays import Array
from armctl.kernels import cost_to_go as kernel
from armctl.scene import BridgeMap

STEPS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2))
"""Offsets from a point to its neighbours, in spacings; edges run both ways."""
OTHER_ROWS = np.array([(sign * right, sign * left) for right, left in STEPS for sign in (1, -1) if right])
"""Those of them that lead to other rows, both ways."""
OFF_CLEARANCE = 3.0
"""Path length (m) added per metre from a point to the nearest one with clearance."""
Floats = NDArray[np.floating[Any]]
Indices = NDArray[np.integer[Any]]


@dataclass(frozen=True)
class Lattice:
    """A lattice of points over decks of one size."""

    length: float
    """m: length of the deck"""
    half_width: float
    """m: half the width of the deck"""
    spacing: float = 0.1
    """m: approximate distance between points"""

    @property
    def shape(self) -> tuple[int, int]:
        """Number of points along the deck, and across it."""
        return len(self.axes[0]), len(self.axes[1])

    def lengths(self, bridge: BridgeMap, goal_x: float, clearance: float) -> Array:
        """Return the length (nx, ny) m of the shortest path from each point to x = `goal_x`, beside lanes."""
        lengths = self.paths(bridge.with_lanes_blocked(), goal_x, clearance)
        nearest, off = self.nearest(np.isfinite(lengths))
        return np.asarray(lengths[nearest] + OFF_CLEARANCE * off)

    def paths(self, bridge: BridgeMap, goal_x: float, clearance: float) -> Array:
        """Return lengths around the blocks only, (nx, ny) m: infinite where there is no path with the clearance."""
        free = bridge.free(*self.axes, clearance)
        beyond_goal = np.broadcast_to(self.axes[0][:, None] >= goal_x, free.shape)
        lengths = np.full(np.add(free.shape, 2 * kernel.PAD), np.inf)
        inside = lengths[kernel.PAD : -kernel.PAD, kernel.PAD : -kernel.PAD]
        inside[beyond_goal & free] = 0.0
        kernel.spread(lengths, free, OTHER_ROWS, self._edges)
        return np.where(beyond_goal, 0.0, inside)

    def nearest(self, mask: NDArray[np.bool_]) -> tuple[tuple[NDArray[np.intp], ...], Array]:
        """Return indices of the nearest point in the `mask` (nx, ny) to each point, and its distance, (nx, ny) m."""
        off, nearest = distance_transform_edt(~mask, self.spacings, return_indices=True)
        return tuple(nearest), np.asarray(off)

    def interpolate(
        self, lengths: Floats, points: Array, every: int = 1, tables: tuple[Indices, ...] | None = None
    ) -> Array:
        """Interpolate lengths (m,) at points (m, 2) bilinearly, each point on a bridge of its own (m, nx, ny).

        Lengths may be those of every second, third ... point in both directions, by `every`. With `tables`, indices
        (m,) of all dimensions but the last two, each point is in its table of `lengths[tables]`, which is not copied.
        """
        last = np.array(lengths.shape[-2:]) - 1
        places = np.clip((points - [0.0, -self.half_width]) / (every * self.spacings), 0, last)
        i, j = corners = np.minimum(places.astype(int), last - 1).T
        x, y = places.T - corners
        bridges = (np.arange(len(points)),) if tables is None else tables
        right = (1 - x) * lengths[*bridges, i, j] + x * lengths[*bridges, i + 1, j]
        left = (1 - x) * lengths[*bridges, i, j + 1] + x * lengths[*bridges, i + 1, j + 1]
        return np.asarray((1 - y) * right + y * left)

    @cached_property
    def axes(self) -> tuple[Array, Array]:
        """Places (nx,) and (ny,) m of the points along the deck and across it."""
        ends = ((0.0, self.length), (-self.half_width, self.half_width))
        x, y = (np.linspace(low, high, 1 + round((high - low) / self.spacing)) for low, high in ends)
        return x, y

    @cached_property
    def spacings(self) -> Array:
        """Distances (2,) m between points along the deck and across it."""
        return np.array([axis[1] - axis[0] for axis in self.axes])

    @cached_property
    def _edges(self) -> Array:
        """Lengths of the edges to `OTHER_ROWS`, and to the next point within a row, m."""
        return np.asarray(np.hypot(*(np.vstack((OTHER_ROWS, (0, 1))) * self.spacings).T))
