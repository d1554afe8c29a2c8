"""Continuous collision checking of an arm's edges: straight joint motions between two configurations.

While joint j turns by dq_j, no point of a capsule moves farther than |dq_j| times its largest distance from that
joint's axis. If two capsules are d_a and d_b apart at an edge's ends, they keep at least (d_a + d_b - motion) / 2 in
between. An edge is bisected until that bound suffices (Schwarzer, Saha and Latombe, "Adaptive dynamic collision
checking for single and multiple robots in complex environments", IEEE Trans. Robotics 2005).
"""

from collections import deque
from operator import attrgetter

import coal
import numpy as np
import pinocchio
from numpy.typing import ArrayLike, NDArray

from armctl.errors import ConfigurationError
from armctl.kinematics.model import ArmModel
from armctl.kinematics.obstacles import add_boxes
from armctl.robot_description.capsules import Capsule
from armctl.robot_description.collision_pairs import FLOOR, add_collision_pairs, capsule_geometry, link_frame
from armctl.scene import Boxes

Array = NDArray[np.float64]

UPRIGHT = 1e-9
"""Tolerance on the cosine of a vertical axis, for rounding."""
FAR = 0.1
"""m: boxes farther than this from a link's reach are not checked against it."""
SECURITY_MARGIN = 0.2
"""m: distances are measured up to this; longer ones cost more time than they save."""
SLACK = 1.5
"""Factor on the clearance at checked configurations, so that the clearance itself is kept in between."""
MAX_CLEARANCE = 0.05
"""m: limit on the clearance, which needs distances of up to twice as much, and boxes as far out of reach."""
NEAR_START = 0.5
"""Fraction of their distance at the start that a pair must keep if it starts nearer than the clearance."""
FINEST = 2**-12
"""Finest fraction of an edge: an edge still undecided there counts as blocked, which bounds the effort."""


class ArmShapes:
    """An arm's collision pairs, and bounds on how far the joints move them; independent of boxes."""

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
        """The geometry with boxes, and bounds on the relative motion of each pair, (pairs, dof) m/rad."""
        geometry = self.geometry.copy()
        add_boxes(geometry, boxes)
        first, second = np.array([(pair.first, pair.second) for pair in geometry.collisionPairs], int).reshape(-1, 2).T
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
        if self._on_upright:  # turning about the vertical does not change heights
            motion[second == geometry.getGeometryId(FLOOR), 0] = 0.0
        return geometry, motion

    def _add_ends_above_floor(self, capsule: Capsule) -> None:
        """Pair the floor with a capsule's two end spheres, one of which touches it first.

        An end that the second joint cannot lower to the floor is left out: a shoulder is near the floor, and stays so.
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
        """Lowest height (m) of a `point` (3,) in the second joint's frame; -inf if unknown."""
        if not self._on_upright:
            return -np.inf
        placements, axis = self.model.pinocchio.jointPlacements, self.model.axes[1]
        shoulder = placements[1] * placements[2]
        upward = float((shoulder.rotation @ axis)[2])
        height = shoulder.translation[2] + (axis @ point) * upward
        return float(height - _off_axis(point, axis) * np.sqrt(max(0.0, 1 - upward**2)))

    def _bounds(self, shape: pinocchio.GeometryObject) -> tuple[Array, float]:
        """Upper bounds on the distance of a shape's points from each joint's axis (dof,) and from the shoulder, m."""
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


class EdgeChecker:
    """Checks whether an arm keeps a clearance (m) from boxes, the floor and itself.

    Pairs that are nearer than that at `start` (dof,) must keep only part of their distance there. Not thread-safe.

    Raises `ConfigurationError` unless the clearance is above 0 and at most `MAX_CLEARANCE`.
    """

    def __init__(self, shapes: ArmShapes, boxes: Boxes, clearance: float, start: Array) -> None:
        if not 0 < clearance <= MAX_CLEARANCE:
            raise ConfigurationError(f"clearance should be above 0 and at most {MAX_CLEARANCE} m, not {clearance!r}")
        self._model, self._self_pairs = shapes.model.pinocchio, shapes.self_pairs
        self._geometry, self._motion = shapes.with_boxes(boxes)
        self._data, self._contacts = self._model.createData(), self._geometry.createData()
        for request in self._contacts.collisionRequests:
            request.security_margin = SECURITY_MARGIN
        self._results = list(self._contacts.collisionResults)
        self.checks = 0
        """Configurations checked."""
        self._ends: dict[bytes, Array] = {}
        distances = self._distances(start)
        self.start_is_free = bool((distances > 0).all())
        self._margins = np.minimum(SLACK * clearance, NEAR_START * np.maximum(distances, 0.0))
        self._kept = self._margins / SLACK

    def is_free(self, q: Array) -> bool:
        """Whether a configuration (dof,) keeps the clearance, with the margin that edges need."""
        return bool((self._distances_at_end(q) >= self._margins).all())

    def is_edge_free(self, a: Array, b: Array) -> bool:
        """Whether the straight motion from `a` to `b`, (dof,) each, keeps the clearance throughout."""
        if not (self.is_free(b) and self.is_free(a)):
            return False
        motion, kept = self._motion @ np.abs(b - a), 2 * self._kept
        halves = deque([(0.0, self._distances_at_end(a), 1.0, self._distances_at_end(b))])
        while halves:
            low, at_low, high, at_high = halves.popleft()
            if (at_low + at_high >= kept + motion * (high - low)).all():
                continue
            middle = (low + high) / 2
            distances = self._distances(a + middle * (b - a))
            if (distances < self._margins).any() or high - low < FINEST:
                return False
            halves += ((low, at_low, middle, distances), (middle, distances, high, at_high))
        return True

    def clearance(self, path: ArrayLike) -> float:
        """Least distance (m) of the arm from boxes and floor at the corners of a path (m, dof); at most `FAR`."""
        corners = (self._distances_at_end(q)[self._self_pairs :] for q in np.asarray(path, float))
        return min((float(distances.min(initial=FAR)) for distances in corners), default=np.nan)

    def _distances_at_end(self, q: Array) -> Array:
        """Cached `_distances`: edges share their ends."""
        key = q.tobytes()
        if key not in self._ends:
            self._ends[key] = self._distances(q)
        return self._ends[key]

    def _distances(self, q: Array) -> Array:
        """Distance of each pair, (pairs,) m: 0 or below in contact, a lower bound beyond `SECURITY_MARGIN`."""
        self.checks += 1
        pinocchio.computeCollisions(self._model, self._data, self._geometry, self._contacts, q, False)
        return np.fromiter(map(_BEYOND_MARGIN, self._results), float, len(self._results)) + SECURITY_MARGIN


_BEYOND_MARGIN = attrgetter("distance_lower_bound")
"""Distance less the security margin: exact if negative, otherwise a lower bound."""


def _off_axis(point: Array, axis: Array) -> float:
    return float(np.linalg.norm(np.cross(axis, point)))
