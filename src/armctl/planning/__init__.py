"""What a planner believes: maps, and paths on them. Nothing here knows of MuJoCo or Gymnasium."""

from armctl.planning.arm_planner import ArmPlan, ArmPlanner, ArmPlannerOptions
from armctl.planning.bridge_map import BridgeMap, Courses
from armctl.planning.cost_to_go import Lattice
from armctl.planning.path_planner import PathPlannerOptions, PlanResult, plan_path

__all__ = [
    "ArmPlan",
    "ArmPlanner",
    "ArmPlannerOptions",
    "BridgeMap",
    "Courses",
    "Lattice",
    "PathPlannerOptions",
    "PlanResult",
    "plan_path",
]
