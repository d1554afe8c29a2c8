"""What is to be done: where episodes start, what is observed, what is rewarded, and how it ends."""

from armctl.tasks.reach import OBSERVATION, REWARD, ReachOptions, ReachState, ReachTask
from armctl.tasks.task import Outcome, RewardLedger, Task

__all__ = ["OBSERVATION", "REWARD", "Outcome", "ReachOptions", "ReachState", "ReachTask", "RewardLedger", "Task"]
