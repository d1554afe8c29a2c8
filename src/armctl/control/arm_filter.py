"""A safety filter of an arm: it changes a command after which the arm could no longer brake without a contact.

Predictive safety filter with a braking back-up (Wabersich and Zeilinger, "A predictive safety filter for learning-based
control of constrained nonlinear dynamical systems", Automatica 129, 2021). A command is safe if the drives, by their
law, keep clear of boxes, the floor and the arm itself for a period under it and while they brake after that. From a
state that a safe command has led to, braking is safe again. So there always is a safe command, if the drives are where
the law says.
"""

import numpy as np

from armctl.core.arrays import Array
from armctl.kernels import braking
from armctl.kernels.edges import NEAR_START, Scene, measure_all
from armctl.kinematics import ArmShapes
from armctl.kinematics.records import box_records
from armctl.robot_description.joint_profiles import TICK
from armctl.scene import Boxes

LAG = 0.003
"""s by which joints are late behind their drives at most, if their motors are at the limit of their torque."""


class ArmFilter:
    """Filters commands of an arm among boxes: positions, or else velocities, each for a `period` (s).

    Pairs of links, and links, floor and boxes keep `margin` (m) from each other, or half of their distance at `home`
    (dof,) if that is less. Joints of a real arm are off their drives, and that takes a margin.
    """

    def __init__(
        self, shapes: ArmShapes, boxes: Boxes, home: Array, *, to_positions: bool, margin: float, period: float
    ) -> None:
        pairs, motion = shapes.with_boxes(boxes)
        scene = Scene(shapes.model.joints, shapes.model.links, pairs, box_records(boxes))
        distances = np.empty(len(pairs))
        measure_all(scene, home, distances)
        caps = NEAR_START * np.maximum(distances, 0.0)
        ticks = max(1, round(period / TICK))
        self._arm = braking.FilteredArm(scene, motion, margin, caps, LAG, to_positions, ticks, TICK)

    def __call__(self, position: Array, velocity: Array, joints: Array, proposal: Array) -> Array:
        """Return the proposed command (dof,) if it is safe, or else a near one that is.

        `position` (dof,) rad and `velocity` (dof,) rad/s are those that the drives command now, and `joints` (dof,) rad
        where the joints are.
        """
        command, recent = np.empty(len(proposal)), np.maximum(np.abs(velocity), np.abs(position - joints) / LAG)
        state = braking.DriveState(position, velocity, recent)
        braking.nearest_safe(self._arm, state, proposal, command)
        return command
