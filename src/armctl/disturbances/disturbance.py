"""What a disturbance is: something that happens between a policy and its robot, and that the policy is not told about."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.errors import ConfigurationError
from armctl.robots.joints import JointSamples
from armctl.simulation import Simulation

Array = NDArray[np.float64]
Observations = NDArray[np.float32] | dict[str, NDArray[Any]]


class Disturbable(Protocol):
    """What disturbances need of a task."""

    simulation: Simulation
    joints: JointSamples | None
    observation_space: gymnasium.spaces.Space[Any]
    action_space: gymnasium.spaces.Box

    @property
    def control_period(self) -> float:
        """Seconds between two control steps."""

    @property
    def idle_action(self) -> Array:
        """The action that leaves the robot where it starts."""

    @property
    def payload_body(self) -> str:
        """The body that carries a payload and that pushes act on."""

    def observe(self, ids: NDArray[np.int32] | None = None) -> Observations:
        """What policies see now."""


class Disturbance:
    """Of one level, in the n worlds of `task`; this one does nothing.

    All chance is drawn from `rngs`, one for each world and of its episode alone: what happens in an episode depends
    neither on the policy nor on the other worlds.
    """

    def __init__(self, task: Disturbable, level: float) -> None:
        self.task, self.level = task, level
        self.worlds = np.arange(task.simulation.n, dtype=np.int32)
        self.rngs = [np.random.default_rng(0)] * task.simulation.n

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Worlds `ids`, which have their new `rngs`, are about to be reset."""

    def command(self, actions: Array) -> Array:
        """What reaches the robots of `actions` (n, ...). Called once a control step, before it is simulated."""
        return actions

    def observe(self, observations: Observations, ids: NDArray[np.int32] | slice) -> Observations:
        """What policies see of the `observations` of worlds `ids`: the same, however often it is called."""
        return observations


def everywhere(task: Disturbable) -> bool:
    """Applies to every task."""
    return True


@dataclass(frozen=True)
class DisturbanceSpec:
    """One kind of disturbance of one kind of task."""

    make: Callable[[Any, float], Disturbance]
    """From the task and the level."""
    does: str
    """What it does, in a line."""
    unit: str
    levels: tuple[float, ...]
    """To try, from the one that changes nothing."""
    highest: float
    """Levels are from 0 to this."""
    whole: bool = False
    """Whether levels are whole numbers."""
    applies: Callable[[Any], bool] = everywhere
    """Whether a task, with its options, can be disturbed in this way."""

    @property
    def neutral(self) -> float:
        """The level that changes nothing."""
        return float(self.levels[0])

    def checked(self, name: str, level: object) -> float:
        """A level as a number; raises `ConfigurationError` for what is none."""
        usable = isinstance(level, (int, float, np.number)) and not isinstance(level, bool)
        if not (usable and 0 <= level <= self.highest and (not self.whole or level == int(level))):  # type: ignore[operator, call-overload]
            number = "a whole number" if self.whole else "a number"
            raise ConfigurationError(f"{name} is {number} from 0 to {self.highest:g} ({self.unit}), not {level!r}")
        return float(level)  # type: ignore[arg-type]
