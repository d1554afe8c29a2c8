"""Tasks: their reset distribution, observation, reward terms and outcomes."""

from armctl.tasks.bridge import (
    BridgeMovingOptions,
    BridgeMovingTask,
    BridgeOptions,
    BridgeOutcome,
    BridgeState,
    BridgeTask,
)
from armctl.tasks.reach import (
    OBSERVATION,
    REWARD,
    MovingReachState,
    ObstaclesReachState,
    ReachMovingOptions,
    ReachMovingTask,
    ReachObstaclesOptions,
    ReachObstaclesTask,
    ReachOptions,
    ReachOutcome,
    ReachState,
    ReachTask,
)
from armctl.tasks.task import (
    FeatureSpec,
    GoalDistance,
    LearnerView,
    MotionSample,
    Observations,
    Once,
    Outcome,
    Potential,
    RewardTerms,
    Task,
)

__all__ = [
    "OBSERVATION", "REWARD", "BridgeMovingOptions", "BridgeMovingTask", "BridgeOptions", "BridgeOutcome",
    "BridgeState", "BridgeTask", "FeatureSpec", "GoalDistance", "LearnerView", "MotionSample", "MovingReachState",
    "Observations", "ObstaclesReachState", "Once", "Outcome", "Potential", "ReachMovingOptions", "ReachMovingTask",
    "ReachObstaclesOptions", "ReachObstaclesTask", "ReachOptions", "ReachOutcome", "ReachState", "ReachTask",
    "RewardTerms", "Task",
]  # fmt: skip
