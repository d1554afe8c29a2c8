"""Simulated robots: their commands and their sensors."""

from armctl.robots.arm import CONTROLS, Arm, build_arm_world
from armctl.robots.rover import Rover

__all__ = ["CONTROLS", "Arm", "Rover", "build_arm_world"]
