"""What every task has, and how an episode can end."""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.robots.joints import JointSamples
from armctl.simulation import Simulation

Array = NDArray[np.float64]
RewardLedger = dict[str, Array]
"""Named reward terms, (n,) each; the reward is their sum."""
Observations = NDArray[np.float32] | dict[str, NDArray[Any]]
"""Of n worlds, (n, ...): one array, or several by name."""


class Outcome(IntEnum):
    """How an episode ends, should it end with this step: all but `TIMEOUT` end it."""

    TIMEOUT = 0
    REACHED = 1
    CROSSED = 2
    COLLIDED = 3
    FELL = 4
    HELD = 5

    @property
    def label(self) -> str:
        """The name that users see."""
        return self.name.lower()

    @property
    def success(self) -> bool:
        """Whether the task was done."""
        return self in (Outcome.REACHED, Outcome.CROSSED, Outcome.HELD)


@dataclass(frozen=True)
class Motion:
    """How n robots move, and what they bear."""

    position: Array
    """(n, 3) m: end-effectors, or rovers."""
    configuration: Array
    """(n, k): joint positions, rad, or the pose x, y (m) and yaw (rad)."""
    joints: Array
    """(2, samples, n, joints) speeds (rad/s) and torques (N m) of joints or wheels since the last decision."""
    contact: NDArray[np.bool_]
    """(n,) whether something was touched that must not be."""


OUTCOME_LABELS = np.array([outcome.label for outcome in Outcome])
SUCCESSES = np.array([outcome.success for outcome in Outcome])


class Task(Protocol):
    """n worlds with a job; all arrays carry a leading axis n."""

    simulation: Simulation
    joints: JointSamples
    substeps: int
    """Physics steps between two decisions."""
    camera: str
    """The MJCF camera that pictures are taken with."""
    observation_space: gymnasium.spaces.Space[Any]
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

    def advance(self, ids: NDArray[np.int32] | None) -> None:
        """Let time go on until the next decision, in worlds `ids` or in all."""
        self.simulation.step(self.substeps, ids)

    def parts(self) -> dict[str, NDArray[np.floating[Any]]]:
        """What is observed now, by name, (n, ...) each."""

    def observe(self, ids: NDArray[np.int32] | None = None) -> Observations:
        """What the policies see now, in worlds `ids` or in all."""

    def score(self) -> RewardLedger:
        """What the last step earned."""

    def outcome(self) -> NDArray[np.int8]:
        """`Outcome` of each world, (n,)."""

    def details(self) -> dict[str, Any]:
        """What `info` says besides: arrays (n,), or dicts of such."""

    def motion(self) -> Motion:
        """How the robots move now, in arrays of their own."""

    def least_clearance(self, world: int, configurations: Array) -> float:
        """Least distance, m, in `Motion.configuration` (decisions, k) of an episode that has just ended in a world.

        From the robot to whatever it must not touch; NaN where that is not known.
        """
        return math.nan

    def least_time(self, world: int) -> float:
        """Seconds in which no policy could do with less until a success from here; NaN where that is not known."""
        return math.nan
