"""An occupancy grid of what stands, and boxes about what is occupied, as planners take them.

Log-odds of cells: Moravec and Elfes, "High resolution maps from wide angle sonar", ICRA 1985; Thrun, Burgard and Fox,
Probabilistic Robotics, 2005, chapter 9.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from armctl.core.arrays import Array
from armctl.kernels import occupancy as kernel

CELL = 0.05
"""m."""
HIT, MISS, LIMITS, OCCUPIED = 0.9, -0.3, (-2.0, 4.0), 1.5
"""Log-odds: by a point, by a ray through a cell, lowest and highest, and from which on a cell is occupied."""
TRUSTED_RANGE = 8.0
"""m: farther points are not entered."""
SHORTER = 0.2
"""m: so far before its point, a ray no longer shows that a cell is free."""
JOIN = 0.2
"""m: half the gap across which occupied cells are one obstacle."""

THICKNESS = 0.2
"""m: so far behind what is seen of it, an obstacle goes on, until other rays show that it does not."""
EVIDENCE = kernel.Evidence(CELL, TRUSTED_RANGE, SHORTER, THICKNESS, HIT, MISS, *LIMITS)
BESIDE = np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)])
"""Offsets of a cell and its neighbours."""


class OccupancyGrid:
    """Cells over a rectangle from `low` to `high`, (2,) m each."""

    def __init__(self, low: tuple[float, float], high: tuple[float, float]) -> None:
        self._low = np.array(low)
        self._shape = np.ceil((np.array(high) - low) / CELL).astype(int)
        self._log_odds = np.zeros(self._shape)
        self._boxes: dict[bytes, tuple[float, ...]] = {}
        """Boxes around the present obstacles, by these obstacles' cells."""

    def add(self, origin: Array, directions: Array, ranges: Array, hits: NDArray[np.bool_]) -> None:
        """Enter what is seen from `origin` (2,) m: it is free up to `ranges` (m,), m, and `hits` (m,) are obstacles.

        `directions` (m, 2) are unit vectors, in order, from -90 to 90 degrees off the middle one. Each tells of all
        cells between those beside it.
        """
        (x, y), (ahead, sideways) = self._low - origin, directions[len(directions) // 2]
        rays = np.arctan2(ahead * directions[:, 1] - sideways * directions[:, 0], directions @ (ahead, sideways))
        order = np.argsort(rays)
        half = np.diff(rays[order]) / 2
        edges = np.concatenate((rays[order[:1]] - half[0], rays[order[:-1]] + half, rays[order[-1:]] + half[-1]))
        tangents = np.tan(np.clip(edges, -np.pi / 2, np.pi / 2))
        view = kernel.View(x, y, ahead, sideways, tangents, ranges[order], hits[order])
        kernel.enter(self._log_odds, EVIDENCE, view)

    def forget(self, points: Array, radius: float) -> None:
        """Forget what was seen within `radius` (m) of points (m, 2)."""
        for point in points:
            first = np.floor((point - radius - self._low) / CELL).astype(int)
            last = np.ceil((point + radius - self._low) / CELL).astype(int)
            (x0, y0), (x1, y1) = np.clip(first, 0, self._shape), np.clip(last, 0, self._shape)
            self._log_odds[x0:x1, y0:y1] = np.minimum(self._log_odds[x0:x1, y0:y1], 0.0)

    def near_occupied(self, points: Array) -> NDArray[np.bool_]:
        """Return which of points (m, 2), m, are in or beside an occupied cell."""
        cells = np.floor((points - self._low) / CELL)
        finite = np.isfinite(cells).all(axis=1)
        cells = np.clip(np.where(finite[:, None], cells, 0), 0, self._shape - 1).astype(int)
        around = cells[:, None] + BESIDE
        around = np.clip(around, 0, self._shape - 1)
        return np.asarray(finite & (self._log_odds[around[..., 0], around[..., 1]] > OCCUPIED).any(axis=1))

    def boxes(self) -> Array:
        """Return the least boxes around all obstacles: x, y (m), yaw (rad), half length and half width (m), (k, 5)."""
        occupied = self._log_odds > OCCUPIED
        cells = np.argwhere(occupied)
        if not len(cells):
            return np.zeros((0, 5))
        reach = round(JOIN / CELL)
        first, last = np.maximum(cells.min(axis=0) - reach, 0), cells.max(axis=0) + reach + 1
        part = occupied[first[0] : last[0], first[1] : last[1]]
        labels, count = ndimage.label(ndimage.maximum_filter(part, 2 * reach + 1, mode="constant"))
        of_cell = labels[tuple((cells - first).T)]
        obstacles, boxes = [cells[of_cell == i + 1] for i in range(count)], self._boxes
        keys = [obstacle.tobytes() for obstacle in obstacles]
        self._boxes = {
            key: boxes.get(key) or smallest_box(self._low + (obstacle + 0.5) * CELL)
            for key, obstacle in zip(keys, obstacles, strict=True)
        }
        return np.array([*self._boxes.values()])


def smallest_box(points: Array) -> tuple[float, float, float, float, float]:
    """Return the box of least area around points (m, 2), m: x, y, yaw, half length, half width.

    One of its sides is along a side of the convex hull.
    """
    try:
        hull = points[ConvexHull(points).vertices]
    except QhullError:  # on a line
        hull = points[[0, -1]] if len(points) > 1 else points
    sides = np.diff(np.vstack((hull, hull[:1])), axis=0)
    angles = np.unique(np.round(np.arctan2(sides[:, 1], sides[:, 0]) % (np.pi / 2), 6))
    cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
    along, across = hull[:, 0] * cos + hull[:, 1] * sin, hull[:, 1] * cos - hull[:, 0] * sin
    length, width = np.ptp(along, axis=1), np.ptp(across, axis=1)
    best = int(np.argmin((length + CELL) * (width + CELL)))
    x, y = (along[best].max() + along[best].min()) / 2, (across[best].max() + across[best].min()) / 2
    c, s = float(cos[best, 0]), float(sin[best, 0])
    return x * c - y * s, x * s + y * c, float(angles[best]), length[best] / 2, width[best] / 2
