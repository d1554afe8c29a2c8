"""Arms that reach: for a target at rest, for a moving target, and around obstacles."""

from armctl.tasks.reach.moving import MovingReachState, ReachMovingOptions, ReachMovingTask
from armctl.tasks.reach.obstacles import ObstaclesReachState, ReachObstaclesOptions, ReachObstaclesTask, read_boxes
from armctl.tasks.reach.reach import CONTROL_PERIOD, ReachOptions, ReachOutcome, ReachTask
from armctl.tasks.reach.state import OBSERVATION, REWARD, ReachState, observation_sizes, observation_slices

__all__ = [
    "CONTROL_PERIOD", "OBSERVATION", "REWARD", "MovingReachState", "ObstaclesReachState", "ReachMovingOptions",
    "ReachMovingTask", "ReachObstaclesOptions", "ReachObstaclesTask", "ReachOptions", "ReachOutcome", "ReachState",
    "ReachTask", "observation_sizes", "observation_slices", "read_boxes",
]  # fmt: skip
