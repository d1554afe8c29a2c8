"""Arms that reach: for a target at rest, for one that moves, and around obstacles."""

from armctl.tasks.reach.moving import MovingReachState, ReachMovingOptions, ReachMovingTask
from armctl.tasks.reach.obstacles import ObstaclesReachState, ReachObstaclesOptions, ReachObstaclesTask, read_boxes
from armctl.tasks.reach.reach import ReachOptions, ReachOutcome, ReachTask
from armctl.tasks.reach.state import OBSERVATION, REWARD, ReachState

__all__ = [
    "OBSERVATION", "REWARD", "MovingReachState", "ObstaclesReachState", "ReachMovingOptions", "ReachMovingTask",
    "ReachObstaclesOptions", "ReachObstaclesTask", "ReachOptions", "ReachOutcome", "ReachState", "ReachTask",
    "read_boxes",
]  # fmt: skip
