"""What is known about an arm: forward kinematics, Jacobians, limits, collisions, and its inverse kinematics."""

from armctl.kinematics.ik import Ik, IkOptions, IkResult
from armctl.kinematics.model import ArmModel
from armctl.kinematics.motions import ArmShapes, FreeMotions
from armctl.kinematics.postures import Postures
from armctl.kinematics.reach_times import LookUp, ReachTimes, Spheres
from armctl.kinematics.touch import THOROUGH, SoonestTouch, Touch, TouchOptions, approach
from armctl.kinematics.workspace import Workspace

__all__ = [
    "THOROUGH",
    "ArmModel",
    "ArmShapes",
    "FreeMotions",
    "Ik",
    "IkOptions",
    "IkResult",
    "LookUp",
    "Postures",
    "ReachTimes",
    "SoonestTouch",
    "Spheres",
    "Touch",
    "TouchOptions",
    "Workspace",
    "approach",
]
