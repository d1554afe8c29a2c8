"""Arms that reach: for a target at rest, for a moving target, for a pose, and around obstacles."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.tasks.reach.moving import MovingReachState, ReachMovingOptions, ReachMovingTask
    from armctl.tasks.reach.observation import OBSERVATION, observation_sizes, observation_slices
    from armctl.tasks.reach.obstacles import ObstaclesReachState, ReachObstaclesOptions, ReachObstaclesTask, read_boxes
    from armctl.tasks.reach.options import ReachOptions
    from armctl.tasks.reach.pose import PoseReachState, ReachPoseOptions, ReachPoseTask
    from armctl.tasks.reach.reach import CONTROL_PERIOD, ReachOutcome, ReachTask
    from armctl.tasks.reach.scenes import ReachScenesOptions, ReachScenesTask, ScenesReachState
    from armctl.tasks.reach.state import REWARD, ReachState

__all__ = [
    "CONTROL_PERIOD", "OBSERVATION", "REWARD", "MovingReachState", "ObstaclesReachState", "PoseReachState",
    "ReachMovingOptions", "ReachMovingTask", "ReachObstaclesOptions", "ReachObstaclesTask", "ReachOptions",
    "ReachOutcome", "ReachPoseOptions", "ReachPoseTask", "ReachScenesOptions", "ReachScenesTask", "ReachState",
    "ReachTask", "ScenesReachState", "observation_sizes", "observation_slices", "read_boxes",
]  # fmt: skip

__getattr__, __dir__ = on_first_use(__name__)
