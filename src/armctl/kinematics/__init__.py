"""Kinematics of an arm: forward and inverse kinematics, Jacobians, limits, collisions, minimum-time reaching."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.kernels.reach import Spheres
    from armctl.kinematics.edge_checker import ArmShapes, EdgeChecker
    from armctl.kinematics.ik import Ik, IkOptions, IkResult
    from armctl.kinematics.imagined import ImaginedArms
    from armctl.kinematics.minimum_time_pose import MinimumTimePose
    from armctl.kinematics.minimum_time_reach import (
        THOROUGH,
        MinimumTimeReach,
        MinimumTimeReachOptions,
        ReachGoal,
        approach,
    )
    from armctl.kinematics.model import ArmModel
    from armctl.kinematics.reach_times import ReachTimes, ReachTimesOptions
    from armctl.kinematics.reachability_map import ReachabilityMap
    from armctl.kinematics.workspace import Workspace

__all__ = [
    "THOROUGH",
    "ArmModel",
    "ArmShapes",
    "EdgeChecker",
    "Ik",
    "IkOptions",
    "IkResult",
    "ImaginedArms",
    "MinimumTimePose",
    "MinimumTimeReach",
    "MinimumTimeReachOptions",
    "ReachGoal",
    "ReachTimes",
    "ReachTimesOptions",
    "ReachabilityMap",
    "Spheres",
    "Workspace",
    "approach",
]

__getattr__, __dir__ = on_first_use(__name__)
