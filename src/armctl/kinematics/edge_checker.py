"""Continuous collision checking of an arm's edges: straight joint motions between two configurations.

While joint j turns by dq_j, no point of a capsule moves farther than |dq_j| times its largest distance from that
joint's axis. If two capsules are d_a and d_b apart at an edge's ends, they keep at least (d_a + d_b - motion) / 2 in
between. An edge is bisected until that bound suffices (Schwarzer, Saha and Latombe, "Adaptive dynamic collision
checking for single and multiple robots in complex environments", IEEE Trans. Robotics 2005).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kernels import edges
from armctl.kinematics.model import ArmModel
from armctl.kinematics.records import Records, box_records
from armctl.robot_description.collision_pairs import is_upright
from armctl.robot_description.joint_profiles import TICK
from armctl.scene import Boxes

FAR = 0.1
"""m: boxes farther than this from a link's reach are not checked against it."""
MAX_CLEARANCE = 0.05
"""m: limit on the clearance, which needs distances of up to twice as much, and boxes as far out of reach."""
HALVINGS, PLACES = 6, 8
"""Number of halvings, and of places tried, to find the farthest point that is reached on an edge of a path."""
TICKS_CHECKED, MAX_CHECKED = 3, 40
"""Ticks of the drives between configurations whose edges are checked, and the number of these: about a second."""
MAX_CHECKS = 2048
"""Configurations on an edge after which it counts as blocked, too."""


class ArmShapes:
    """An arm's pairs that may collide, and bounds on how far the joints move them; independent of boxes."""

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        links = model.links
        self._on_upright = is_upright(model.pinocchio)
        ends = np.stack((links["start"], links["end"]), axis=1)
        bounds = [self._bounds(*link) for link in zip(links["joint"], ends, links["radius"], strict=True)]
        self._radii = np.array([radii for radii, _ in bounds]).reshape(-1, len(model.joints))
        self._reach = np.array([reach for _, reach in bounds])
        self.self_pairs = len(model.link_pairs)
        self._pairs = [(edges.LINKS, *pair) for pair in model.link_pairs]
        self._motion = [
            np.maximum(self._radii[first], self._radii[second]) * self._between(*links["joint"][[first, second]])
            for first, second in model.link_pairs
        ]
        for link in model.floor_links:
            joint, _, _, radius = links[link]
            for end in (0, 1):
                if joint == 2 and self._lowest_on_second_joint(ends[link, end]) > radius:
                    continue  # a shoulder is near the floor, and stays so
                self._pairs.append((edges.FLOOR_END, link, end))
                self._motion.append(self._bounds(joint, ends[link, [end]], radius)[0])
                self._motion[-1][0] *= not self._on_upright  # turning about the vertical does not change heights

    def with_boxes(self, boxes: Boxes) -> tuple[Records, Array]:
        """Return all pairs with `boxes`, and bounds on their relative motion, (pairs, dof) m/rad."""
        beyond = boxes.distances(self.model.shoulder)
        near = (beyond[:, None] <= self._reach + FAR) & (self.model.links["joint"] > 0)
        pairs = [*self._pairs, *((edges.LINK_AND_BOX, link, box) for box, link in np.argwhere(near))]
        motion = [*self._motion, *self._radii[np.argwhere(near)[:, 1]]]
        return np.array(pairs, dtype=edges.PAIR), self._by_motors(motion)

    def with_any_boxes(self, max_boxes: int) -> tuple[Records, Array, int]:
        """Return the same for any `max_boxes` boxes: all own pairs, their number, then the pairs of each box.

        The pairs of k boxes come first among these.
        """
        moving = np.flatnonzero(self.model.links["joint"] > 0)
        pairs = [*self._pairs, *((edges.LINK_AND_BOX, link, box) for box in range(max_boxes) for link in moving)]
        motion = [*self._motion, *np.tile(self._radii[moving], (max_boxes, 1))]
        return np.array(pairs, dtype=edges.PAIR), self._by_motors(motion), len(self._pairs)

    def _by_motors(self, motion: Sequence[Array]) -> Array:
        """Return bounds (pairs, dof) on relative motion, by those (pairs, m) of all joints with and without motor."""
        of_joints, description = np.array(motion).reshape(-1, len(self.model.joints)), self.model.description
        return of_joints @ np.abs(description.coupling[0]) if description.followers else of_joints

    def _between(self, first: int, second: int) -> NDArray[np.bool_]:
        """Return which joints (m,) move two joints' frames against each other."""
        joints = np.arange(1, len(self.model.joints) + 1)
        return np.asarray((joints > min(first, second)) & (joints <= max(first, second)))

    def _lowest_on_second_joint(self, point: Array) -> float:
        """Return the lowest height (m) of a `point` (3,) in the second joint's frame; -inf if unknown."""
        first, second = self.model.joints[:2]
        if not self._on_upright or second["slides"]:
            return -np.inf
        axis, upward = self.model.axes[1], float((first["base"] @ second["base"] @ self.model.axes[1])[2])
        height = (first["offset"] + first["base"] @ second["offset"])[2] + (axis @ point) * upward
        return float(height - _off_axis(point, axis) * np.sqrt(max(0.0, 1 - upward**2)))

    def _bounds(self, joint: int, ends: Array, radius: float) -> tuple[Array, float]:
        """Bound how far a shape's points move with each joint (m,) m/rad, and their distance (m) from the shoulder.

        The former is their distance from the joint's axis.

        Its points are within `radius` of a segment between `ends` (k, 3), in the frame of `joint`.
        """
        radii = np.zeros(len(self.model.joints))
        if joint == 0:
            return radii, 0.0
        joints, limits, description = self.model.joints, self.model.limits, self.model.description
        ends_of_range = (description.all_positions(end) for end in (limits.lower, limits.upper))
        slides = joints["slides"] * np.maximum(*map(abs, ends_of_range))
        radii[joint - 1] = max(_off_axis(end, self.model.axes[joint - 1]) for end in ends) + radius
        reach = max(float(np.linalg.norm(end)) for end in ends) + radius
        for i in range(joint - 1, 0, -1):
            offset = joints[i]["offset"]
            radii[i - 1] = _off_axis(offset, self.model.axes[i - 1]) + slides[i] + reach
            reach += float(np.linalg.norm(offset)) + slides[i]
        radii[:joint][joints["slides"][:joint] > 0] = 1.0  # a joint that slides moves all points alike
        return radii, reach + slides[0]


class EdgeChecker:
    """Checks whether an arm keeps a clearance (m) from boxes, the floor and itself.

    Pairs that are nearer than that at `start` (dof,) must keep only part of their distance there. Not thread-safe.

    Raises `ConfigurationError` unless the clearance is above 0 and at most `MAX_CLEARANCE`.
    """

    def __init__(self, shapes: ArmShapes, boxes: Boxes, clearance: float, start: Array) -> None:
        if not 0 < clearance <= MAX_CLEARANCE:
            raise ConfigurationError(f"clearance should be above 0 and at most {MAX_CLEARANCE} m, not {clearance!r}")
        pairs, motion = shapes.with_boxes(boxes)
        self._self_pairs = shapes.self_pairs
        self._scene = edges.Scene(shapes.model.joints, shapes.model.links, pairs, box_records(boxes))
        self._distances = np.empty((MAX_CHECKS, len(pairs)))
        self.checks = 0
        """Configurations checked."""
        distances = self._measured(start)
        self.start_is_free = bool((distances > 0).all())
        self._full_margins = np.minimum(edges.SLACK * clearance, edges.NEAR_START * np.maximum(distances, 0.0))
        self._motion = motion
        self._set_margins(self._full_margins)

    def is_free(self, q: Array) -> bool:
        """Return True if a configuration (dof,) keeps the clearance, with the margin that edges need."""
        self.checks += 1
        self._distances[0] = 0.0
        return bool(edges.measure(*self._scene, q, self._bounds.margins, self._distances[0]))

    def is_edge_free(self, a: Array, b: Array) -> bool:
        """Return True if the straight motion from `a` to `b`, (dof,) each, keeps the clearance throughout."""
        free, checks = edges.check_edge(self._scene, a, b, self._bounds)
        self.checks += checks
        return bool(free)

    def relax(self, q: Array, share: float) -> bool:
        """Lower the margins of pairs that are too near at `q` (dof,) to a share of their distance there.

        Without that, no motion away from there would be free. Pairs in contact stay blocked. Returns whether there are
        such pairs.
        """
        distances = self._measured(q)
        self._set_margins(np.minimum(self._full_margins, share * np.maximum(distances, 0.0)))
        return bool((distances < self._full_margins).any())

    def farthest_goal(self, path: Array, q: Array) -> Array | None:
        """Return the farthest point (dof,) of a path (m, dof) with a free straight motion from `q` (dof,), if any."""
        goal = np.empty(len(q))
        exists, checks = edges.farthest_goal(self._scene, path, q, HALVINGS, PLACES, self._bounds, goal)
        self.checks += checks
        return goal if exists else None

    def stops_freely(self, position: Array, velocity: Array, goal: Array) -> bool:
        """Return True if drives from `position` (dof,) with `velocity` (dof,) keep the clearance to rest at `goal`."""
        free, checks = edges.stops_freely(
            self._scene, position, velocity, goal, TICKS_CHECKED, TICK, MAX_CHECKED, self._bounds
        )
        self.checks += checks
        return bool(free)

    def shortened(self, path: Array, draws: Array, faster: float) -> Array:
        """Return the path (m, dof) after shortcuts between random places, where they are free and save time.

        `draws` (k, 2) are shares of the path's time at the velocity limits, and `faster` is the share of the time
        between such places that a shortcut may need.
        """
        room = np.vstack((path, np.empty((len(draws), path.shape[1]))))
        corners, checks = edges.shortcut(self._scene, room, len(path), draws, faster, self._bounds)
        self.checks += checks
        return room[:corners]

    def clearance(self, path: ArrayLike) -> float:
        """Return the least distance (m) from boxes and floor at the corners of a path (m, dof); at most `FAR`."""
        corners = (self._measured(q)[self._self_pairs :] for q in np.asarray(path, float))
        return min((float(distances.min(initial=FAR)) for distances in corners), default=np.nan)

    def _set_margins(self, margins: Array) -> None:
        self._bounds = edges.Bounds(margins, self._motion, self._distances)

    def _measured(self, q: Array) -> Array:
        """Return the distance of each pair, (pairs,) m: 0 or below in contact."""
        self.checks += 1
        distances = np.empty(len(self._scene.pairs))
        edges.measure_all(self._scene, q, distances)
        return distances


def _off_axis(point: Array, axis: Array) -> float:
    (a, b, c), (x, y, z) = axis, point
    return float(np.linalg.norm((b * z - c * y, c * x - a * z, a * y - b * x)))  # np.cross takes six times as long
