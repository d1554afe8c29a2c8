"""A safety filter of an arm: it changes a command after which the arm could no longer brake without a contact.

Predictive safety filter with a braking back-up (Wabersich and Zeilinger, "A predictive safety filter for learning-based
control of constrained nonlinear dynamical systems", Automatica 129, 2021). A command is safe if the arm keeps clear of
boxes, the floor and itself for a period under it and while it brakes after that: its drives move by their law, and its
joints follow these as the torques of their motors allow. From a state that a safe command has led to, braking is safe
again. So there always is a safe command, if the arm is as heavy and as strong as its description says.
"""

import numpy as np

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kernels import arm_filter as kernel
from armctl.kernels import braking
from armctl.kernels.edges import NEAR_START, Scene, measure_all
from armctl.kinematics import ArmShapes
from armctl.kinematics.records import body_records, box_records
from armctl.robot_description.joint_profiles import FOLLOWING_ERROR, TICK
from armctl.scene import Boxes

TIME_STEP = 0.002
"""s of the joints' motion."""
HELD = 25
"""Periods of the back-up that goes on to the commanded positions, where most joints rest by then."""


class ArmFilter:
    """Filters commands of an arm among boxes: positions, or else velocities, each for a `period` (s).

    Pairs of links, and links, floor and boxes keep `margin` (m) from each other, or half of their distance at home if
    that is less. Servos have a stiffness (N m/rad) and damping (N m s/rad), `gains` (2, dof).
    """

    def __init__(
        self, shapes: ArmShapes, boxes: Boxes, gains: Array, *, to_positions: bool, margin: float, period: float
    ) -> None:
        pairs, motion = shapes.with_boxes(boxes)
        model = shapes.model
        if model.description.followers:
            raise ConfigurationError("the safety filter has no dynamics of an arm with joints that follow others")
        scene = Scene(model.joints, model.links, pairs, box_records(boxes))
        distances = np.empty(len(pairs))
        measure_all(scene, model.home, distances)
        caps = NEAR_START * np.maximum(distances, 0.0)
        bodies = body_records(model.pinocchio, model.description, *gains)
        self.arm = braking.FilteredArm(
            scene, bodies, motion, margin, caps, to_positions, FOLLOWING_ERROR, max(1, round(period / TICK)),
            HELD if to_positions else 0, (TIME_STEP, round(TICK / TIME_STEP)),
        )  # fmt: skip

        self._plan = kernel.Plan(np.empty(model.dof), np.zeros(1, dtype=np.int64))

    def __call__(self, state: braking.ArmState, proposal: Array) -> Array:
        """Return the proposed command (dof,) if it is safe, or else a near one that is."""
        command = np.empty(len(proposal))
        kernel.nearest_safe(self.arm, state, proposal, self._plan, command)
        return command
