"""What a planner believes: maps, and paths on them. Nothing here knows of MuJoCo or Gymnasium."""

from armctl.planning.arm_planner import ArmPlan, ArmPlanner, ArmPlannerOptions
from armctl.planning.bridge_planner import PathPlannerOptions, PlanResult, plan_path
from armctl.planning.cost_to_go import Lattice

__all__ = [
    "ArmPlan",
    "ArmPlanner",
    "ArmPlannerOptions",
    "Lattice",
    "PathPlannerOptions",
    "PlanResult",
    "plan_path",
]
