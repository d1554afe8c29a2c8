"""Simulated robots: their commands and their sensors."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.robots.arm import CONTROLS, Arm, build_arm_world
    from armctl.robots.rover import Rover

__all__ = ["CONTROLS", "Arm", "Rover", "build_arm_world"]

__getattr__, __dir__ = on_first_use(__name__)
