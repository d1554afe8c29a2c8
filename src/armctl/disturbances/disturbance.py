"""What a disturbance is: something that happens between a policy and its robot, and that nobody tells the policy of."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.errors import ConfigurationError
from armctl.robots.arm import PREFIX as ARM
from armctl.robots.rover import PREFIX as ROVER
from armctl.tasks import Observations, ReachTask, Task

Array = NDArray[np.float64]


class Disturbance:
    """Of one level, in the n worlds of `task`; this one does nothing.

    All chance is drawn from `rngs`, one for each world and of its episode alone: what happens in an episode depends
    neither on the policy nor on the other worlds.
    """

    def __init__(self, task: Task, level: float) -> None:
        self.task, self.level = task, level
        self.worlds = np.arange(task.simulation.n, dtype=np.int32)
        self.rngs = [np.random.default_rng(0)] * task.simulation.n

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Worlds `ids`, which have their new `rngs`, are about to be reset."""

    def command(self, actions: Array) -> Array:
        """What reaches the robots of `actions` (n, ...), once a decision, before time goes on."""
        return actions

    def observe(self, observations: Observations, ids: NDArray[np.int32] | slice) -> Observations:
        """What the policies see of `observations` of worlds `ids`; however often it is asked for, the same."""
        return observations


def carrier(task: Task) -> int:
    """The body that carries a payload, and that pushes meet: end-effector or base."""
    name = ARM + task.arm.description.tip if isinstance(task, ReachTask) else ROVER + "base"
    return int(task.simulation.model.body(name).id)


@dataclass(frozen=True)
class Kind:
    """One kind of disturbance of one kind of robot."""

    make: Callable[[Task, float], Disturbance]
    does: str
    """What it does, in a line."""
    unit: str
    levels: tuple[float, ...]
    """To try, from the one that changes nothing."""
    highest: float
    """Levels are from 0 to this."""
    whole: bool = False
    """Whether levels are whole numbers."""

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
