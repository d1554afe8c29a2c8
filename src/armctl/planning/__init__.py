"""Path planners for arms and for the bridge, independent of MuJoCo and Gymnasium."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.planning.arm_planner import ArmPlan, ArmPlanner, ArmPlannerOptions
    from armctl.planning.bridge_planner import PathPlannerOptions, PlanResult, plan_path
    from armctl.planning.cost_to_go import Lattice
    from armctl.planning.path_certificate import PathCertificate, PathCertificateOptions
    from armctl.planning.time_to_go import SpaceTime, TimesToGo

__all__ = [
    "ArmPlan",
    "ArmPlanner",
    "ArmPlannerOptions",
    "Lattice",
    "PathCertificate",
    "PathCertificateOptions",
    "PathPlannerOptions",
    "PlanResult",
    "SpaceTime",
    "TimesToGo",
    "plan_path",
]

__getattr__, __dir__ = on_first_use(__name__)
