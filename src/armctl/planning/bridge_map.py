"""What a planner knows of a bridge: where its sides and blocks are, and who walks where.

x runs along the bridge from its start, y across it from its middle. No way is ever drawn here, only distances.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components

Array = NDArray[np.float64]
EdgeTest = Callable[[float, float, float, float], bool]


@dataclass(frozen=True, eq=False)
class Courses:
    """w walkers, each of whom goes there and back on a straight line, and turns at once at its ends.

    With leading axes in front of w, as many bridges at once.
    """

    start: Array
    """(..., w, 2), m."""
    end: Array
    """(..., w, 2), m."""
    speed: Array
    """(..., w), m/s."""
    phase: Array
    """How far along the way there and back each is at time 0, (..., w), m."""
    radius: float
    """Of a walker, m."""

    @property
    def along(self) -> NDArray[np.bool_]:
        """Who walks along the bridge rather than across it, (..., w)."""
        way = np.abs(self.end - self.start)
        return np.asarray(way[..., 0] > way[..., 1])

    def across(self) -> "Courses":
        """Those who walk across the bridge, (w,); only of one bridge."""
        who = ~self.along
        return Courses(self.start[who], self.end[who], self.speed[who], self.phase[who], self.radius)

    def positions(self, times: ArrayLike) -> Array:
        """Where they are at times (...), s: (..., w, 2)."""
        length = np.linalg.norm(self.end - self.start, axis=-1)
        share = np.abs(self._walked(times, length) - length) / length  # 1 at the start, 0 at the end
        return np.asarray(self.end + (self.start - self.end) * share[..., None])

    def velocities(self, times: ArrayLike) -> Array:
        """How they move at times (...), s: (..., w, 2), m/s."""
        length = np.linalg.norm(self.end - self.start, axis=-1)
        sense = np.where(self._walked(times, length) < length, 1.0, -1.0)
        return np.asarray((sense * self.speed / length)[..., None] * (self.end - self.start))

    def _walked(self, times: ArrayLike, length: Array) -> Array:
        """Way since they last were at the start, there and back."""
        return np.asarray((self.phase + np.asarray(times, dtype=float)[..., None] * self.speed) % (2 * length))


NOBODY = Courses(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), 0.0)


@dataclass(frozen=True, eq=False)
class BridgeMap:
    """A bridge from above."""

    length: float
    """Of the deck, m."""
    half_width: float
    """Of the free deck between the barriers, m: |y| is less on it."""
    blocks: Array
    """(k, 5): x, y (m), yaw (rad), half length and half width (m) of what stands on the deck."""
    courses: Courses = NOBODY

    def clearance(self, points: ArrayLike) -> Array:
        """Distance of points (m, 2) to the nearest block, side or end of the deck, (m,); not above 0 inside a block."""
        points = np.asarray(points, dtype=float)
        _, across = _in_frames(points, self.blocks)
        outside = np.abs(across) - self.blocks[:, 3:]
        distance = np.linalg.norm(np.maximum(outside, 0.0), axis=-1) + np.minimum(outside.max(axis=-1), 0.0)
        return np.asarray(np.minimum(distance.min(axis=1, initial=np.inf), self._to_edges(points)))

    def segment_clearance(self, starts: ArrayLike, ends: ArrayLike) -> Array:
        """Exact distance of segments between points (m, 2) to the nearest block, side or end of the deck, (m,)."""
        starts, ends = np.asarray(starts, dtype=float), np.asarray(ends, dtype=float)
        to_edges = np.minimum(self._to_edges(starts), self._to_edges(ends))
        to_blocks = _to_boxes(starts, ends, self.blocks).min(axis=1, initial=np.inf)
        return np.asarray(np.minimum(to_blocks, to_edges))

    def with_lanes_blocked(self) -> "BridgeMap":
        """The map with a block in place of each lane along the bridge, and without walkers.

        There is a way beside such a lane; a lane across the bridge can only be waited for.
        """
        courses, along = self.courses, self.courses.along
        middle, half = ((courses.end + sign * courses.start)[along] / 2 for sign in (1, -1))
        sizes = np.abs(half) + courses.radius
        lanes = np.column_stack((middle, np.zeros(len(middle)), sizes))
        return dataclasses.replace(self, blocks=np.vstack((self.blocks, lanes)), courses=NOBODY)

    def crossable(self, radius: float) -> bool:
        """Whether a disc can get from before all blocks to behind them, past lanes along the bridge: exactly.

        By duality: it cannot if and only if blocks with gaps too narrow for it make a wall from side to side.
        """
        blocks = self.with_lanes_blocked().blocks
        k = len(blocks)
        corners = _corners(blocks)
        edges = corners.reshape(-1, 2), np.roll(corners, -1, axis=1).reshape(-1, 2)
        gaps = _to_boxes(*edges, blocks).reshape(k, 4, k).min(axis=1)
        walls = np.zeros((k + 2, k + 2), dtype=bool)
        walls[:k, :k] = gaps < 2 * radius
        walls[k, :k] = self.half_width - corners[..., 1].max(axis=1, initial=-np.inf) < 2 * radius
        walls[k + 1, :k] = self.half_width + corners[..., 1].min(axis=1, initial=np.inf) < 2 * radius
        _, wall = connected_components(walls, directed=False)
        return bool(wall[k] != wall[k + 1] and radius <= self.half_width)

    def edge_test(self, clearance: float) -> EdgeTest:
        """Test whether a segment from x, y to x, y has that clearance: `segment_clearance` for a single one.

        In plain floats, and asking only blocks nearby, it takes a tenth of the time.
        """
        corners, (x, y, yaw, half_length, half_width) = _corners(self.blocks), self.blocks.T
        boxes = np.column_stack(
            (
                corners.min(axis=1, initial=np.inf) - clearance,
                corners.max(axis=1, initial=-np.inf) + clearance,
                *(x, y, np.cos(yaw), np.sin(yaw), half_length, half_width),
            )
        ).tolist()
        side, last = self.half_width - clearance, self.length - clearance

        def free(ax: float, ay: float, bx: float, by: float) -> bool:
            if not (abs(ay) <= side and abs(by) <= side and clearance <= ax <= last and clearance <= bx <= last):
                return False
            for left, bottom, right, top, *box in boxes:
                apart = (ax < left and bx < left) or (ax > right and bx > right)
                apart = apart or (ay < bottom and by < bottom) or (ay > top and by > top)
                if not apart and _nearer_than(clearance, ax, ay, bx, by, *box):
                    return False
            return True

        return free

    def _to_edges(self, points: Array) -> Array:
        x, y = points.T
        return np.asarray(np.minimum(self.half_width - np.abs(y), np.minimum(x, self.length - x)))


def _in_frames(points: Array, boxes: Array) -> tuple[Array, Array]:
    """Rotations (k, 2, 2) of boxes (k, 5), and points (m, 2) in their frames, (m, k, 2)."""
    cos, sin = np.cos(boxes[:, 2]), np.sin(boxes[:, 2])
    rotations = np.stack((cos, -sin, sin, cos), axis=-1).reshape(-1, 2, 2)
    return rotations, np.einsum("mki,kij->mkj", points[:, None] - boxes[:, :2], rotations)


def _corners(boxes: Array) -> Array:
    """Corners (k, 4, 2) of boxes (k, 5), in turn."""
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])
    rotations, _ = _in_frames(np.zeros((0, 2)), boxes)
    return np.asarray(boxes[:, None, :2] + np.einsum("kci,kji->kcj", signs * boxes[:, None, 3:], rotations))


def _to_boxes(starts: Array, ends: Array, boxes: Array) -> Array:
    """Distances (m, k) of segments between points (m, 2) to boxes (k, 5); 0 where they meet.

    A segment that does not meet a box is nearest to it at one of its own ends, or at a corner of the box.
    """
    half = boxes[:, 3:]
    _, a = _in_frames(starts, boxes)
    _, b = _in_frames(ends, boxes)
    way = b - a
    safe = np.where(np.abs(way) < 1e-12, 1e-12, way)
    enter, leave = (-half - a) / safe, (half - a) / safe
    first = np.minimum(enter, leave).max(axis=-1)
    last = np.maximum(enter, leave).min(axis=-1)
    meets = np.maximum(first, 0.0) <= np.minimum(last, 1.0)
    ends_apart = np.minimum(*(np.linalg.norm(np.maximum(np.abs(p) - half, 0.0), axis=-1) for p in (a, b)))
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * half[:, None]
    offset = corners - a[:, :, None]
    squared = np.maximum((way * way).sum(axis=-1), 1e-24)
    share = np.clip((offset * way[:, :, None]).sum(axis=-1) / squared[..., None], 0.0, 1.0)
    corners_apart = np.linalg.norm(offset - share[..., None] * way[:, :, None], axis=-1).min(axis=-1)
    return np.asarray(np.where(meets, 0.0, np.minimum(ends_apart, corners_apart)))


def _nearer_than(
    distance: float, ax: float, ay: float, bx: float, by: float,
    x: float, y: float, cos: float, sin: float, half_length: float, half_width: float,
) -> bool:  # fmt: skip
    """Whether a segment is nearer to a box than a distance: `_to_boxes` for one of each."""
    ax, ay, bx, by = ax - x, ay - y, bx - x, by - y
    ax, ay, bx, by = ax * cos + ay * sin, ay * cos - ax * sin, bx * cos + by * sin, by * cos - bx * sin
    squared = distance * distance
    for px, py in ((ax, ay), (bx, by)):
        dx, dy = max(abs(px) - half_length, 0.0), max(abs(py) - half_width, 0.0)
        if dx * dx + dy * dy < squared:
            return True
    wx, wy = bx - ax, by - ay
    way = wx * wx + wy * wy
    if way == 0.0:
        return False
    left = right = 0
    for cx, cy in (
        (half_length, half_width), (-half_length, half_width), (-half_length, -half_width), (half_length, -half_width),
    ):  # fmt: skip
        dx, dy = cx - ax, cy - ay
        side, along = wx * dy - wy * dx, dx * wx + dy * wy
        if 0.0 <= along <= way and side * side < squared * way:
            return True
        left, right = left + (side >= 0), right + (side <= 0)
    # Corners on both sides of its line: it goes through the box, or ends outside before it.
    return left > 0 and right > 0 and _crosses(ax, ay, wx, wy, half_length, half_width)


def _crosses(ax: float, ay: float, wx: float, wy: float, half_length: float, half_width: float) -> bool:
    first, last = 0.0, 1.0
    for a, w, half in ((ax, wx, half_length), (ay, wy, half_width)):
        if abs(w) < 1e-12:
            if abs(a) > half:
                return False
            continue
        enter, leave = sorted(((-half - a) / w, (half - a) / w))
        first, last = max(first, enter), min(last, leave)
    return first <= last


def is_point(point: Any) -> bool:
    """Whether something is a point: two finite numbers."""
    try:
        numbers = np.asarray(point, dtype=float)
    except (TypeError, ValueError):
        return False
    return numbers.shape == (2,) and bool(np.isfinite(numbers).all())
