"""What every task has, and how an episode can end."""

from enum import IntEnum
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.simulation import Simulation

Array = NDArray[np.float64]
RewardLedger = dict[str, Array]
"""Named reward terms, (n,) each; the reward is their sum."""


class Outcome(IntEnum):
    """How an episode ends, should it end with this step: all but `TIMEOUT` end it."""

    TIMEOUT = 0
    REACHED = 1

    @property
    def label(self) -> str:
        """The name that users see."""
        return self.name.lower()

    @property
    def success(self) -> bool:
        """Whether the task was done."""
        return self is Outcome.REACHED


OUTCOME_LABELS = np.array([outcome.label for outcome in Outcome])
SUCCESSES = np.array([outcome.success for outcome in Outcome])


class Task(Protocol):
    """n worlds with a job; all arrays carry a leading axis n."""

    simulation: Simulation
    substeps: int
    """Physics steps between two decisions."""
    camera: str
    """The MJCF camera that pictures are taken with."""
    observation_space: gymnasium.spaces.Box
    """Of one world."""
    action_space: gymnasium.spaces.Box
    """Of one world."""

    @property
    def interface(self) -> dict[str, str]:
        """What a policy is made for: a learned one must have been trained on the same."""

    def reset(self, ids: NDArray[np.int32], rngs: list[np.random.Generator]) -> None:
        """Start new episodes in worlds `ids`, each drawn from its own generator."""

    def command(self, actions: Array) -> None:
        """Hand actions (n, ...) to the robots; they act on the simulation's next steps."""

    def parts(self) -> dict[str, NDArray[np.floating[Any]]]:
        """What is observed now, by name, (n, ...) each."""

    def observe(self) -> NDArray[np.float32]:
        """What the policies see now."""

    def score(self) -> RewardLedger:
        """What the last step earned."""

    def outcome(self) -> NDArray[np.int8]:
        """`Outcome` of each world, (n,)."""

    def details(self) -> dict[str, NDArray[Any]]:
        """What `info` says besides, (n,) each."""
