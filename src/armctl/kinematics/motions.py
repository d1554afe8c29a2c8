"""Which motions of an arm are free: straight ones between two configurations, checked without gaps.

While joint j turns by dq_j, no point of a capsule moves farther than |dq_j| times its greatest distance from that
joint's axis. Two configurations with distances d_a and d_b between two capsules thus leave (d_a + d_b - motion) / 2
between them, all the way, or more: a motion is halved until that is enough (Schwarzer, Saha and Latombe, "Adaptive
dynamic collision checking for single and multiple robots in complex environments", IEEE Trans. Robotics 2005).
"""

from collections import deque

import coal
import numpy as np
import pinocchio
from numpy.typing import ArrayLike, NDArray

from armctl.boxes import Boxes
from armctl.capsules import Capsule
from armctl.collisions import FLOOR, add_boxes, add_collision_pairs, capsule_geometry, link_frame
from armctl.kinematics.model import ArmModel

Array = NDArray[np.float64]

UPRIGHT = 1e-9
"""How far from 1 the cosine of a vertical axis may be, by rounding."""
FAR = 0.1
"""m: boxes farther than this from all that a link can reach are none of its business."""
SLACK = 1.5
"""Times the clearance that is kept where a motion is checked, so that the clearance itself is kept in between."""
NEAR_START = 0.5
"""Part of the distance at the start that two things must keep, where that is less than is asked for."""


class ArmShapes:
    """What of an arm can touch what, and how far the joints can move it: all that does not depend on boxes."""

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        description = model.description
        pairs = description.collision_pairs
        self.geometry = capsule_geometry(model.pinocchio, description.capsules)
        add_collision_pairs(self.geometry, (pair for pair in pairs if FLOOR not in pair))
        self.self_pairs = len(self.geometry.collisionPairs)
        grounded = {link for pair in pairs if FLOOR in pair for link in pair}
        self._on_upright = abs((model.pinocchio.jointPlacements[1].rotation @ model.axes[0])[2]) > 1 - UPRIGHT
        for capsule in description.capsules:
            if capsule.link in grounded:
                self._add_ends_above_floor(capsule)
        bounds = [self._bounds(shape) for shape in self.geometry.geometryObjects]
        self._radii, self._reach = np.array([radii for radii, _ in bounds]), np.array([reach for _, reach in bounds])

    def with_boxes(self, boxes: Boxes) -> tuple[pinocchio.GeometryModel, Array]:
        """The geometry among boxes, and how far each of its pairs may move against each other, (pairs, dof) m/rad."""
        geometry = self.geometry.copy()
        add_boxes(geometry, boxes)
        first, second = np.array([(pair.first, pair.second) for pair in geometry.collisionPairs]).reshape(-1, 2).T
        beyond = np.concatenate((np.full(len(self._reach), -np.inf), boxes.distances(self.model.shoulder)))
        near = beyond[second] <= np.append(self._reach, np.zeros(len(boxes)))[first] + FAR
        first, second = first[near], second[near]
        geometry.removeAllCollisionPairs()
        for pair in zip(first.tolist(), second.tolist(), strict=True):
            geometry.addCollisionPair(pinocchio.CollisionPair(*pair))

        joints = np.array([shape.parentJoint for shape in geometry.geometryObjects])
        radii = np.vstack((self._radii, np.zeros((len(boxes), self.model.dof))))
        pairs = np.sort((joints[first], joints[second]), axis=0)[..., None]
        between = (np.arange(self.model.dof) >= pairs[0]) & (np.arange(self.model.dof) < pairs[1])
        motion = np.maximum(radii[first], radii[second]) * between
        if self._on_upright:  # turning about the vertical leaves heights as they are
            motion[second == geometry.getGeometryId(FLOOR), 0] = 0.0
        return geometry, motion

    def _add_ends_above_floor(self, capsule: Capsule) -> None:
        """Let the floor meet a capsule's two ends, one of which it meets first.

        Not an end that the second joint cannot turn down to it: a shoulder is near the floor, and stays there.
        """
        frame = self.model.pinocchio.frames[link_frame(self.model.pinocchio, capsule.link)]
        for name, end in (("start", capsule.start), ("end", capsule.end)):
            centre = frame.placement.act(np.array(end))
            if frame.parentJoint == 2 and self._lowest_on_second_joint(centre) > capsule.radius:
                continue
            placement, ball = pinocchio.SE3(np.eye(3), centre), coal.Sphere(capsule.radius)
            name = f"{capsule.link} ({name})"
            self.geometry.addGeometryObject(pinocchio.GeometryObject(name, frame.parentJoint, placement, ball))
            add_collision_pairs(self.geometry, [(name, FLOOR)])

    def _lowest_on_second_joint(self, point: Array) -> float:
        """Height (m) to which a `point` (3,) in the second joint's frame can come down; -inf if that is not known."""
        if not self._on_upright:
            return -np.inf
        placements, axis = self.model.pinocchio.jointPlacements, self.model.axes[1]
        shoulder = placements[1] * placements[2]
        upward = float((shoulder.rotation @ axis)[2])
        height = shoulder.translation[2] + (axis @ point) * upward
        return float(height - _off_axis(point, axis) * np.sqrt(max(0.0, 1 - upward**2)))

    def _bounds(self, shape: pinocchio.GeometryObject) -> tuple[Array, float]:
        """How far a shape's points can be from each joint's axis (dof,) and from the shoulder, at most, m."""
        radii, joint = np.zeros(self.model.dof), shape.parentJoint
        if joint == 0:
            return radii, 0.0
        half = np.array([0, 0, getattr(shape.geometry, "halfLength", 0.0)])
        ends = [shape.placement.act(end) for end in (half, -half)]
        axis = self.model.axes[joint - 1]
        radii[joint - 1] = max(_off_axis(end, axis) for end in ends) + shape.geometry.radius
        reach = max(float(np.linalg.norm(end)) for end in ends) + shape.geometry.radius
        for i in range(joint - 1, 0, -1):
            offset = self.model.pinocchio.jointPlacements[i + 1].translation
            radii[i - 1] = _off_axis(offset, self.model.axes[i - 1]) + reach
            reach += float(np.linalg.norm(offset))
        return radii, reach


class FreeMotions:
    """Motions of an arm among boxes that keep a clearance, m, from boxes, the floor and the arm itself.

    What is nearer to each other at `start` (dof,) need keep only part of its distance there. Not for several threads.
    """

    def __init__(self, shapes: ArmShapes, boxes: Boxes, clearance: float, start: Array) -> None:
        self._model, self._self_pairs = shapes.model.pinocchio, shapes.self_pairs
        self._geometry, self._motion = shapes.with_boxes(boxes)
        self._data, self._contacts = self._model.createData(), self._geometry.createData()
        self._results = list(self._contacts.collisionResults)
        self.checks = 0
        """Configurations checked."""
        self.start_is_free = self.is_free(start)
        margins = np.zeros(len(self._results))
        if self.start_is_free:
            margins = np.minimum(SLACK * clearance, NEAR_START * self._room())
        for request, margin in zip(self._contacts.collisionRequests, margins.tolist(), strict=True):
            request.security_margin = margin
        self._margins, self._spare = margins, 2 * margins * (1 - 1 / SLACK)
        self._ends: dict[bytes, Array | None] = {}

    def is_free(self, q: Array) -> bool:
        """Whether a configuration (dof,) keeps the clearance, and what is to be kept where motions are checked."""
        self.checks += 1
        return not pinocchio.computeCollisions(self._model, self._data, self._geometry, self._contacts, q, True)

    def leads(self, a: Array, b: Array) -> bool:
        """Whether the straight motion from `a` to `b`, (dof,) each, keeps the clearance all the way."""
        room_b = self._room_at_end(b)
        room_a = None if room_b is None else self._room_at_end(a)
        if room_a is None or room_b is None:
            return False
        motion = self._motion @ np.abs(b - a)
        halves = deque([(0.0, room_a, 1.0, room_b)])
        while halves:
            low, room_low, high, room_high = halves.popleft()
            if (room_low + room_high + self._spare >= motion * (high - low)).all():
                continue
            middle = (low + high) / 2
            if not self.is_free(a + middle * (b - a)):
                return False
            room = self._room()
            halves += ((low, room_low, middle, room), (middle, room, high, room_high))
        return True

    def clearance(self, path: ArrayLike) -> float:
        """Least distance, m, of the arm from boxes and floor at the corners of a path (m, dof); at most `FAR`."""
        return min((self._distance(q) for q in np.asarray(path, float)), default=np.nan)

    def _room_at_end(self, q: Array) -> Array | None:
        """Room at a configuration where motions end, many of them at some; None if it is not free."""
        key = q.tobytes()
        if key not in self._ends:
            self._ends[key] = self._room() if self.is_free(q) else None
        return self._ends[key]

    def _room(self) -> Array:
        """Distance beyond its margin of each pair, (pairs,) m, at the free configuration that was checked last."""
        return np.array([result.distance_lower_bound for result in self._results])

    def _distance(self, q: Array) -> float:
        room = self._room_at_end(q)
        return 0.0 if room is None else float((room + self._margins)[self._self_pairs :].min(initial=FAR))


def _off_axis(point: Array, axis: Array) -> float:
    return float(np.linalg.norm(np.cross(axis, point)))
