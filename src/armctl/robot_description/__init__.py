"""What is known of an arm before any software models it: one URDF, limits, capsules, pairs that may collide."""

from armctl.robot_description.arm import BUILTIN_ARMS, ArmDescription, JointLimits, load_arm
from armctl.robot_description.capsules import Capsule

__all__ = ["BUILTIN_ARMS", "ArmDescription", "Capsule", "JointLimits", "load_arm"]
