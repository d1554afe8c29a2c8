"""How robots are commanded and what they sense."""

from armctl.robots.arm import CONTROLS, Arm, build_arm_world

__all__ = ["CONTROLS", "Arm", "build_arm_world"]
