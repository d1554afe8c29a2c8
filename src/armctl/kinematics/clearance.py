"""Distances of an arm's links from obstacles and each other, and their gradients, for many configurations at once.

Links are capsules: segments with a radius. Distances from boxes are sampled along the segment, those from the floor are
taken at its ends, and those between links in closed form (Ericson, "Real-time collision detection", 2005, section
5.1.9).
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from armctl.kinematics.model import ArmModel, cross
from armctl.robot_description.collision_pairs import FLOOR, link_frame
from armctl.scene import Boxes

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SPACING = 0.06
"""m: largest spacing of sample points. A link of 5 cm radius may be nearer to an edge by 8 mm than they show."""


Contacts = tuple[Array, Array, Integers, Integers, Array]
"""Of p pairs: points (n, p, 3) on links, normals (n, p, 3) towards them, links, other links (-1: none), their feet."""
Part = tuple[Array, Callable[[], Contacts]]
"""Distances (n, p) of p pairs, m, and a function that computes their contacts on demand."""


class Clearance:
    """Distances of one arm's links from `model.boxes`, the floor and each other."""

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        capsules = {capsule.link: capsule for capsule in model.description.capsules}
        links = list(capsules)
        placements = [model.pinocchio.frames[link_frame(model.pinocchio, link)] for link in links]
        self._joints = np.array([frame.parentJoint for frame in placements])
        ends = [
            [frame.placement.act(np.array(end)) for end in (capsules[link].start, capsules[link].end)]
            for link, frame in zip(links, placements, strict=True)
        ]
        self._ends = np.array(ends).reshape(-1, 2, 3)
        self._radii = np.array([capsule.radius for capsule in capsules.values()])
        pairs = [pair for pair in model.description.collision_pairs if FLOOR not in pair]
        self._pairs = np.array([[links.index(link) for link in pair] for pair in pairs], dtype=int).reshape(-1, 2)
        on_floor = [pair[0] for pair in model.description.collision_pairs if pair[1] == FLOOR]
        self._floor_links = np.repeat([links.index(link) for link in on_floor], 2).astype(int)
        self._floor_ends = np.tile([0, 1], len(on_floor))
        # the first link only turns on the spot
        self._among_boxes = np.flatnonzero(self._joints > 1)
        length = np.linalg.norm(self._ends[:, 1] - self._ends[:, 0], axis=-1)
        self._counts = 1 + np.ceil(length / SPACING).astype(int)
        self._set_points()
        self._drop_fixed_ends()

    def _drop_fixed_ends(self) -> None:
        """Drop link ends whose height the joints do not change: their distance from the floor is fixed."""
        samples = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, self.model.dof))
        heights = self._segment_ends(self.model.joint_frames(samples))[:, self._floor_links, self._floor_ends, 2]
        moves = np.ptp(heights, axis=0) > self._radii[self._floor_links]
        self._floor_links, self._floor_ends = self._floor_links[moves], self._floor_ends[moves]

    def _set_points(self) -> None:
        """Sample points along the links, at which distances from boxes are taken."""
        shares = [np.linspace(0, 1, self._counts[link]) for link in self._among_boxes]
        self._shares = np.concatenate([np.zeros(0), *shares])
        self._point_links = np.repeat(self._among_boxes, self._counts[self._among_boxes])
        counts = self._counts[self._among_boxes]
        self._first_points = np.concatenate(([0], np.cumsum(counts)[:-1])).astype(int)

    def nearest(self, frames: Array, boxes: Boxes, count: int) -> "Nearest":
        """The `count` nearest pairs at `ArmModel.joint_frames` (n, dof, 4, 4)."""
        return Nearest(self, frames, boxes, count)

    def parts(self, frames: Array, boxes: Boxes) -> list[Part]:
        """All pairs: of links with the floor, with each other, and with boxes."""
        ends = self._segment_ends(frames)
        parts = [self._from_floor(ends), self._from_links(ends)]
        return [*parts, self._from_boxes(ends, boxes)] if len(boxes) else parts

    def moved(self, frames: Array, points: Array, normals: Array, links: Integers) -> Array:
        """Motion of points (n, m, 3) on `links` (n, m) along `normals` per joint, (n, m, dof) m/rad."""
        axes = self.model.joint_axes(frames)
        turned = np.swapaxes(cross(axes, frames[..., :3, 3]), -1, -2)
        moved = cross(points, normals) @ np.swapaxes(axes, -1, -2) - normals @ turned  # n . (a x (p - o))
        carried = np.arange(1, self.model.dof + 1) <= self._joints[links][..., None]
        return np.asarray(moved * carried)

    def _segment_ends(self, frames: Array) -> Array:
        """Ends of all links' segments, (n, links, 2, 3) m."""
        base = np.broadcast_to(np.eye(4), (*frames.shape[:-3], 1, 4, 4))
        frames = np.concatenate((base, frames), axis=-3)[:, self._joints]
        return np.asarray(self._ends @ np.swapaxes(frames[..., :3, :3], -1, -2) + frames[..., None, :3, 3])

    def _from_floor(self, ends: Array) -> Part:
        ends = ends[:, self._floor_links, self._floor_ends]

        def contacts() -> Contacts:
            links = np.broadcast_to(self._floor_links, ends.shape[:-1])
            return ends, np.broadcast_to((0.0, 0.0, 1.0), ends.shape), links, np.full(links.shape, -1), ends

        return ends[..., 2] - self._radii[self._floor_links], contacts

    def _from_links(self, ends: Array) -> Part:
        first, second = ends[:, self._pairs[:, 0]], ends[:, self._pairs[:, 1]]
        points, feet = nearest_on_segments(first[:, :, 0], first[:, :, 1], second[:, :, 0], second[:, :, 1])
        offset = points - feet
        length = np.sqrt(_dot(offset, offset))

        def contacts() -> Contacts:
            links, others = (np.broadcast_to(self._pairs[:, i], length.shape) for i in (0, 1))
            return points, offset / np.maximum(length, 1e-9)[..., None], links, others, feet

        return length - self._radii[self._pairs].sum(axis=1), contacts

    def _from_boxes(self, ends: Array, boxes: Boxes) -> Part:
        n, k = len(ends), len(boxes)
        start, end = ends[:, self._point_links, 0], ends[:, self._point_links, 1]
        points = start + self._shares[:, None] * (end - start)
        distances = _distances(points.reshape(-1, 3), boxes).reshape(n, -1, k)
        least = np.minimum.reduceat(distances, self._first_points, axis=1) - self._radii[self._among_boxes, None]

        def contacts() -> Contacts:
            last = [*self._first_points[1:], len(self._shares)]
            nearest = [i + distances[:, i:j].argmin(axis=1) for i, j in zip(self._first_points, last, strict=True)]
            which = np.stack(nearest, axis=1).reshape(n, -1)  # point, for each link and box
            chosen = points[np.arange(n)[:, None], which]
            links = np.broadcast_to(np.repeat(self._among_boxes, k), which.shape)
            normals = _normals(chosen, boxes, np.tile(np.arange(k), len(self._among_boxes)))
            return chosen, normals, links, np.full(links.shape, -1), chosen

        return least.reshape(n, -1), contacts


class Nearest:
    """The pairs nearest to contact in n configurations; see `Clearance.nearest`."""

    def __init__(self, clearance: Clearance, frames: Array, boxes: Boxes, count: int) -> None:
        self._clearance, self._frames, self._count = clearance, frames, count
        distances, self._contacts = zip(*clearance.parts(frames, boxes), strict=True)
        self._distances = np.concatenate(distances, axis=1)
        self.least = self._distances.min(axis=1, initial=np.inf)
        """(n,) m: distance of the nearest pair"""

    @cached_property
    def rows(self) -> tuple[Array, Array]:
        """Distances (n, m) m and gradients (n, m, dof) m/rad; infinite and zero if there are fewer pairs."""
        few = min(self._count, self._distances.shape[1])
        # in an order that stays the same from one configuration to the next
        chosen = np.sort(np.argpartition(self._distances, few - 1, axis=1)[:, :few], axis=1)
        row = np.arange(len(chosen))[:, None]
        contacts = zip(*(contact() for contact in self._contacts), strict=True)
        points, normals, links, others, feet = (np.concatenate(part, axis=1)[row, chosen] for part in contacts)
        gradients = self._clearance.moved(self._frames, points, normals, links)
        paired = others >= 0
        if paired.any():
            gradients -= paired[..., None] * self._clearance.moved(self._frames, feet, normals, others)
        distances, missing = self._distances[row, chosen], (0, self._count - few)
        if few == self._count:
            return distances, gradients
        return (
            np.pad(distances, ((0, 0), missing), constant_values=np.inf),
            np.pad(gradients, ((0, 0), missing, (0, 0))),
        )


def nearest_on_segments(a: Array, b: Array, c: Array, d: Array) -> tuple[Array, Array]:
    """The points of segments ab and cd, (..., 3) each, that are nearest to each other."""
    along, across, between = b - a, d - c, a - c
    aa, cc, ac = _dot(along, along), _dot(across, across), _dot(along, across)
    ab, cb = _dot(along, between), _dot(across, between)
    tiny = 1e-12  # m^2: segments that are points, or parallel
    share = np.clip((ac * cb - ab * cc) / np.maximum(aa * cc - ac * ac, tiny), 0.0, 1.0)
    other = np.clip((ac * share + cb) / np.maximum(cc, tiny), 0.0, 1.0)
    share = np.clip((ac * other - ab) / np.maximum(aa, tiny), 0.0, 1.0)
    return a + share[..., None] * along, c + other[..., None] * across


def _distances(points: Array, boxes: Boxes) -> Array:
    """Signed distances (p, k) of points (p, 3) from all boxes: a faster `Boxes.distances`."""
    rotations = boxes.rotations
    into = np.moveaxis(rotations, 0, 2).reshape(3, -1)  # columns: first axes of all boxes, second axes, third axes
    centres = np.einsum("ki,kij->jk", boxes.centres, rotations)
    local = (points @ into).reshape(len(points), 3, len(boxes)) - centres
    x, y, z = np.moveaxis(np.abs(local) - boxes.half_sizes.T, 1, 0)
    inside = np.minimum(np.maximum(np.maximum(x, y), z), 0.0)
    x, y, z = np.maximum(x, 0.0), np.maximum(y, 0.0), np.maximum(z, 0.0)
    return np.asarray(np.sqrt(x * x + y * y + z * z) + inside)


def _normals(points: Array, boxes: Boxes, which: Integers) -> Array:
    """Outward normals (n, p, 3) at points (n, p, 3), each of one box, `which` (p,)."""
    rotations = boxes.rotations[which]
    local = ((points - boxes.centres[which])[..., None, :] @ rotations)[..., 0, :]
    beyond = np.abs(local) - boxes.half_sizes[which]
    outside = np.maximum(beyond, 0.0)
    length = np.sqrt(_dot(outside, outside))[..., None]
    face = beyond == beyond.max(axis=-1, keepdims=True)
    away = np.copysign(np.where(length > 0, outside / np.maximum(length, 1e-12), face), local)
    return np.asarray((away[..., None, :] @ np.swapaxes(rotations, -1, -2))[..., 0, :])


def _dot(first: Array, second: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", first, second))
