"""Tasks: their reset distribution, observation, reward terms and outcomes."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.core.arrays import Observations
    from armctl.tasks.bridge import (
        BarnMovingOptions,
        BarnMovingTask,
        BarnOptions,
        BarnTask,
        BridgeMovingOptions,
        BridgeMovingTask,
        BridgeOptions,
        BridgeOutcome,
        BridgeState,
        BridgeTask,
    )
    from armctl.tasks.goals import Goals
    from armctl.tasks.learner_view import FeatureSpec, LearnerView
    from armctl.tasks.lift import LiftOptions, LiftOutcome, LiftState, LiftTask
    from armctl.tasks.push import PushOptions, PushOutcome, PushState, PushTask
    from armctl.tasks.reach import (
        OBSERVATION,
        REWARD,
        MovingReachState,
        ObstaclesReachState,
        PoseReachState,
        ReachMovingOptions,
        ReachMovingTask,
        ReachObstaclesOptions,
        ReachObstaclesTask,
        ReachOptions,
        ReachOutcome,
        ReachPoseOptions,
        ReachPoseTask,
        ReachScenesOptions,
        ReachScenesTask,
        ReachState,
        ReachTask,
        ScenesReachState,
    )
    from armctl.tasks.task import (
        EachStep,
        GoalDistance,
        MotionSample,
        OneTimeTerm,
        Outcome,
        Potential,
        RewardTerms,
        Task,
    )

__all__ = [
    "OBSERVATION",
    "REWARD",
    "BarnMovingOptions",
    "BarnMovingTask",
    "BarnOptions",
    "BarnTask",
    "BridgeMovingOptions",
    "BridgeMovingTask",
    "BridgeOptions",
    "BridgeOutcome",
    "BridgeState",
    "BridgeTask",
    "EachStep",
    "FeatureSpec",
    "GoalDistance",
    "Goals",
    "LearnerView",
    "LiftOptions",
    "LiftOutcome",
    "LiftState",
    "LiftTask",
    "MotionSample",
    "MovingReachState",
    "Observations",
    "ObstaclesReachState",
    "OneTimeTerm",
    "Outcome",
    "PoseReachState",
    "Potential",
    "PushOptions",
    "PushOutcome",
    "PushState",
    "PushTask",
    "ReachMovingOptions",
    "ReachMovingTask",
    "ReachObstaclesOptions",
    "ReachObstaclesTask",
    "ReachOptions",
    "ReachOutcome",
    "ReachPoseOptions",
    "ReachPoseTask",
    "ReachScenesOptions",
    "ReachScenesTask",
    "ReachState",
    "ReachTask",
    "RewardTerms",
    "ScenesReachState",
    "Task",
]  # fmt: skip

__getattr__, __dir__ = on_first_use(__name__)
