"""Distances of an arm's links from obstacles and each other, and their gradients, for many configurations at once.

Links are capsules: segments with a radius. Distances from boxes are sampled along the segment, those from the floor are
taken at its ends, and those between links in closed form (Ericson, "Real-time collision detection", 2005, section
5.1.9). `armctl.kernels.clearance` does the arithmetic.
"""

import numpy as np
from numpy.typing import NDArray

from armctl.kernels import capsules, clearance, edges
from armctl.kinematics.model import ArmModel
from armctl.kinematics.records import Records, box_records
from armctl.scene import Boxes

Array = NDArray[np.float64]
Scene = tuple[Records, Records, Records, NDArray[np.int64]]
"""Links, pairs, boxes, and the number of sample points along each link, for `armctl.kernels.clearance`."""

SPACING = 0.06
"""m: largest spacing of sample points. A link of 5 cm radius may be nearer to an edge by 8 mm than they show."""


class Clearance:
    """Distances of one arm's links from `model.boxes`, the floor and each other."""

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        links = model.links
        length = np.linalg.norm(links["end"] - links["start"], axis=-1)
        self._samples = 1 + np.ceil(length / SPACING).astype(int)
        self._pairs = [(edges.FLOOR_END, *end) for end in self._ends_over_floor()]
        self._pairs += [(edges.LINKS, *pair) for pair in model.link_pairs]
        self.scene = self.among(model.boxes)

    def among(self, boxes: Boxes) -> Scene:
        """What to measure among boxes. The first link only turns on the spot, and is not checked against them."""
        moving = np.flatnonzero(self.model.links["joint"] > 1)
        with_boxes = [(edges.LINK_AND_BOX, link, box) for link in moving for box in range(len(boxes))]
        pairs = np.array([*self._pairs, *with_boxes], dtype=edges.PAIR)
        return self.model.links, pairs, box_records(boxes), self._samples

    def least(self, q: Array, scene: Scene | None = None) -> Array:
        """The least distance of all pairs, (n,) m, at each of q (n, dof)."""
        least = np.empty(len(q))
        clearance.clearances(self.model.joints, *(scene or self.scene), np.ascontiguousarray(q), least)
        return least

    def nearest(self, q: Array, count: int) -> tuple[Array, Array]:
        """Distances (n, count) m of the nearest pairs at q (n, dof), and their gradients (n, count, dof) m/rad.

        They are in an order that stays the same from one configuration to the next; infinite and zero if there are
        fewer pairs.
        """
        distances, gradients = np.empty((len(q), count)), np.empty((len(q), count, self.model.dof))
        clearance.nearest_pairs(self.model.joints, *self.scene, np.ascontiguousarray(q), distances, gradients)
        return distances, gradients

    def _ends_over_floor(self) -> NDArray[np.int64]:
        """Links and their ends (k, 2) that may come near the floor: those whose height the joints change."""
        samples = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, self.model.dof))
        ends = np.empty((len(samples), len(self.model.links), 2, 3))
        capsules.place_all(self.model.joints, self.model.links, samples, ends)
        moves = np.ptp(ends[..., 2], axis=0) > self.model.links["radius"][:, None]
        return np.array([(link, end) for link in self.model.floor_links for end in (0, 1) if moves[link, end]], int)
