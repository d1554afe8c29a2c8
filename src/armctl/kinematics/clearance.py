"""Distances of an arm's links from obstacles and each other, and their gradients, for many configurations at once.

Links are capsules: segments with a radius. Distances from boxes are sampled along the segment, those from the floor are
taken at its ends, and those between links in closed form (Ericson, "Real-time collision detection", 2005, section
5.1.9). `armctl.kernels.clearance` does the arithmetic.
"""

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels import capsules, clearance, edges
from armctl.kernels.clearance import ScaledScene
from armctl.kinematics.model import ArmModel
from armctl.kinematics.records import box_records
from armctl.robot_description.collision_pairs import is_upright
from armctl.scene import NO_BOXES, Boxes

SPACING = 0.06
"""m: largest spacing of sample points. A link of 5 cm radius may be nearer to an edge by 8 mm than they show."""
OF_HOME = 0.5
"""Share of its distance at home that a pair of the arm itself has to keep at most."""
NARROWEST = 0.005
"""m: margin of pairs that a way passes at less."""


class Clearance:
    """Distances of one arm's links from `model.boxes`, the floor and each other.

    For a controller that keeps a `margin` (m), distances of links from the floor and each other are scaled, so that
    `margin` stands for the share `OF_HOME` of the distance at home where that is less: some links are always near each
    other, and no motion would keep them farther apart. For the same reason, no pair has to be farther apart than it is
    on a way that the controller is to follow.
    """

    def __init__(self, model: ArmModel, margin: float = 0.0) -> None:
        self.model, self._margin = model, margin
        links = model.links
        length = np.linalg.norm(links["end"] - links["start"], axis=-1)
        self._samples = 1 + np.ceil(length / SPACING).astype(int)
        self._pairs = [(edges.FLOOR_END, *end) for end in self._ends_over_floor()]
        self._pairs += [(edges.LINKS, *pair) for pair in model.link_pairs]
        self._scales = np.ones(len(self._pairs))
        self.scene = self.among(NO_BOXES)
        at_home = self.nearest(model.home[None], len(self._pairs))[0][0]
        self._scales = np.maximum(1.0, margin / (OF_HOME * at_home))
        self.scene = self.among(model.boxes)

    def among(self, boxes: Boxes) -> ScaledScene:
        """Return the scene among boxes. The first link of an upright arm is not checked: it turns on the spot."""
        moving = np.flatnonzero(self.model.links["joint"] > int(is_upright(self.model.pinocchio)))
        with_boxes = [(edges.LINK_AND_BOX, link, box) for link in moving for box in range(len(boxes))]
        pairs = np.array([*self._pairs, *with_boxes], dtype=edges.PAIR)
        scales = np.concatenate((self._scales, np.ones(len(with_boxes))))
        return ScaledScene(self.model.joints, self.model.links, pairs, box_records(boxes), self._samples, scales)

    def along(self, way: Array) -> ScaledScene:
        """Return the same scene for a controller that is to follow a `way` (n, dof)."""
        scales = self.scene.scales
        distances = self.nearest(way, len(scales))[0].min(axis=0) / scales
        return self.scene._replace(scales=np.maximum(scales, self._margin / np.maximum(distances, NARROWEST)))

    def min_distances(self, q: Array, scene: ScaledScene | None = None) -> Array:
        """Return the least distance of all pairs, (n,) m, at each of q (n, dof)."""
        min_distances = np.empty(len(q))
        clearance.clearances(scene or self.scene, np.ascontiguousarray(q), min_distances)
        return min_distances

    def nearest(self, q: Array, count: int) -> tuple[Array, Array]:
        """Return distances (n, count) m of the nearest pairs at q (n, dof), and their gradients (n, count, dof) m/rad.

        They are in an order that stays the same from one configuration to the next; infinite and zero if there are
        fewer pairs.
        """
        distances, gradients = np.empty((len(q), count)), np.empty((len(q), count, self.model.dof))
        clearance.nearest_pairs(self.scene, np.ascontiguousarray(q), distances, gradients)
        return distances, gradients

    def _ends_over_floor(self) -> NDArray[np.int64]:
        """Return links and their ends (k, 2) that may come near the floor: those whose height the joints change."""
        samples = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, self.model.dof))
        ends = np.empty((len(samples), len(self.model.links), 2, 3))
        capsules.place_all(self.model.joints, self.model.links, samples, ends)
        moves = np.ptp(ends[..., 2], axis=0) > self.model.links["radius"][:, None]
        return np.array([(link, end) for link in self.model.floor_links for end in (0, 1) if moves[link, end]], int)
