"""What is to be done: where episodes start, what is observed, what is rewarded, and how it ends."""

from armctl.tasks.bridge import BridgeOptions, BridgeState, BridgeTask
from armctl.tasks.reach import OBSERVATION, REWARD, ReachOptions, ReachState, ReachTask
from armctl.tasks.reach_moving import MovingReachState, ReachMovingOptions, ReachMovingTask
from armctl.tasks.reach_obstacles import ObstaclesReachState, ReachObstaclesOptions, ReachObstaclesTask
from armctl.tasks.task import Observations, Outcome, RewardLedger, Task

__all__ = [
    "OBSERVATION", "REWARD", "BridgeOptions", "BridgeState", "BridgeTask", "MovingReachState", "Observations",
    "ObstaclesReachState", "Outcome", "ReachMovingOptions", "ReachMovingTask", "ReachObstaclesOptions",
    "ReachObstaclesTask", "ReachOptions", "ReachState", "ReachTask", "RewardLedger", "Task",
]  # fmt: skip
