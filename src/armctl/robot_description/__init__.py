"""Descriptions of arms, independent of simulator and controllers: URDF, limits, capsules, collision pairs."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.robot_description.arm import ArmDescription, JointLimits, load_arm
    from armctl.robot_description.builtin import BUILTIN_ARMS
    from armctl.robot_description.capsules import Capsule

__all__ = ["BUILTIN_ARMS", "ArmDescription", "Capsule", "JointLimits", "load_arm"]

__getattr__, __dir__ = on_first_use(__name__)
