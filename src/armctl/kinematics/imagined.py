"""Many arms that are imagined at once among their boxes: they move exactly as commanded, and nothing is simulated.

The drives' commands in an armctl environment depend on the actions alone (`armctl.robot_description.joint_profiles`),
and the joints follow them within some mrad. So what an arm will do can be foreseen by kinematics, about as far as
nothing is touched.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kernels import imagined_arm
from armctl.kernels.capsules import BOX
from armctl.kernels.imagined_arm import ARRIVED, MOVING, TOUCHED
from armctl.kinematics.edge_checker import ArmShapes
from armctl.robot_description.joint_profiles import TICK
from armctl.scene.boxes import BOX_NUMBERS, box_rotations

MAX_CHECKS = 64
"""Configurations on a straight motion after which it counts as blocked."""

__all__ = ["ARRIVED", "MOVING", "TOUCHED", "ImaginedArms"]


class ImaginedArms:
    """n arms of one kind, each with its target and up to `max_boxes` boxes. Not thread-safe.

    An arm has to keep `margin` (m) from boxes, floor and itself, or half of its distance at the start if that is less.
    It arrives when its end-effector is within `tolerance` (m) of its target after a tick. `period` (s) is that of
    control steps. Raises `ConfigurationError` for a negative margin.
    """

    def __init__(
        self, shapes: ArmShapes, n: int, max_boxes: int, *, tolerance: float, period: float, margin: float = 0.0
    ) -> None:
        if not 0 <= margin < np.inf:
            raise ConfigurationError(f"margin should be 0 m or more, not {margin!r}")
        model = shapes.model
        self.model, self.tolerance, self.margin, self.max_boxes = model, tolerance, margin, max_boxes
        self._ticks = max(1, round(period / TICK))
        pairs, motion, num_own_pairs = shapes.with_any_boxes(max_boxes)
        self.positions: Array = np.tile(model.home, (n, 1))
        """(n, dof) rad: of the commands, which the joints follow."""
        self.velocities: Array = np.zeros((n, model.dof))
        """(n, dof) rad/s: of the commands."""
        self.targets: Array = np.zeros((n, 3))
        """(n, 3) m."""
        self.states = np.full(n, TOUCHED)
        """(n,) `MOVING`, `ARRIVED` or `TOUCHED`: arms that do not move stand still."""
        self._arms = imagined_arm.Arms(
            model.joints, model.links, pairs, motion, num_own_pairs, (len(pairs) - num_own_pairs) // max(max_boxes, 1),
            np.zeros((n, max_boxes), BOX), np.zeros(n, int), self.positions, self.velocities, self.targets, self.states,
            *np.zeros((2, n, len(pairs))),
        )  # fmt: skip
        self._distances = np.empty((MAX_CHECKS, len(pairs)))

    @property
    def tips(self) -> Array:
        """End-effector positions (n, 3), m."""
        return self.model.positions(self.positions)

    def begin(self, ids: ArrayLike, positions: Array, velocities: ArrayLike, targets: Array, boxes: Array) -> None:
        """Begin new episodes of arms `ids` (k,), at `positions` with `velocities`, (k, dof) each.

        `targets` are (k, 3) m, and `boxes` (k, `max_boxes`, `BOX_NUMBERS` or `TILTED_BOX_NUMBERS`), absent ones last.
        """
        rows = np.asarray(ids, dtype=int)
        numbers = np.asarray(boxes, dtype=float).reshape(len(rows), self.max_boxes, np.shape(boxes)[-1] or BOX_NUMBERS)
        self.positions[rows], self.velocities[rows], self.targets[rows] = positions, velocities, targets
        self._arms.counts[rows] = (numbers[..., 3:6] > 0).all(axis=-1).sum(axis=-1)
        records = np.zeros(numbers.shape[:2], BOX)
        records["rotation"] = box_rotations(*np.moveaxis(numbers[..., 6:], -1, 0))
        records["centre"], records["half_size"] = numbers[..., :3], numbers[..., 3:6]
        self._arms.boxes[rows], self.states[rows] = records, MOVING
        imagined_arm.begin(self._arms, rows, self.margin)

    def move(self, commands: Array) -> None:
        """Make one control step with `commands` (n, dof): joint positions (rad) to move to and stop at."""
        limits = self.model.limits
        goals = np.clip(np.asarray(commands, dtype=float), limits.lower, limits.upper)
        imagined_arm.move(self._arms, self.tolerance, goals, self._ticks, TICK)

    def next_waypoints(self, ways: Array, lengths: NDArray[np.int64], margin: float, best: NDArray[np.int64]) -> None:
        """Raise `best` (n,) to the farthest corner of each arm's way to which a straight joint motion is free.

        Ways are (n, m, dof) rad; their first `lengths` (n,) corners count. A motion is free if it keeps `margin` (m),
        or half of its start's distance if that is less, at configurations so near to each other that two thirds of it
        are kept in between. Arms that do not move keep what was found before.
        """
        imagined_arm.farthest_waypoints(self._arms, ways, lengths, margin, self._distances, best)
