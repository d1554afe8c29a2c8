"""Base class of disturbances: what may go wrong between a policy and its robot, without the policy's knowledge."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array, Observations
from armctl.core.errors import ConfigurationError
from armctl.robots.joints import JointSamples
from armctl.simulation import Simulation

Channel = Literal["observation", "state", "action", "physics"]
"""Target of a disturbance. Policies read observation, state, both or none; actions and physics reach all of them."""


class Disturbable(Protocol):
    """Interface that disturbances need of a task."""

    n: int
    simulation: Simulation
    joints: JointSamples | None
    observation_space: gymnasium.spaces.Space[Any]
    action_space: gymnasium.spaces.Box

    @property
    def control_period(self) -> float:
        """Seconds between two control steps."""

    @property
    def physical(self) -> bool:
        """True if masses, friction and pushes change anything."""

    @property
    def idle_action(self) -> Array:
        """The action that leaves the robot where it starts."""

    @property
    def payload_body(self) -> str:
        """The body to which payloads are attached and pushes are applied."""

    def observe(self, ids: NDArray[np.int32] | None = None) -> Observations:
        """Return the current observations of policies."""


class Disturbance:
    """A disturbance in the n worlds of `task`, at one `level`; the base class does nothing.

    All randomness comes from `rngs`, one generator per world and episode. So a disturbance depends neither on the
    policy nor on the other worlds.
    """

    channels: ClassVar[frozenset[Channel]] = frozenset({"physics"})
    """Channels it acts on. A subclass that overrides `observe` acts on the observation unless it says more itself."""
    per_episode: ClassVar[bool] = False
    """True if each episode can have a level of its own: the class goes by `levels`, not by `level`."""
    renewed = False
    """True if `apply` has to be called again in each episode."""

    def __init__(self, task: Disturbable, level: float) -> None:
        self.task, self.level = task, level
        self.levels = np.full(task.n, float(level))
        """(n,) level of each world's episode. `level` is the highest if they are drawn."""
        self.drawn_from: LevelRange | None = None
        """Where each episode's level is drawn from; None: all are `level`."""
        self.worlds = np.arange(task.n, dtype=np.int32)
        self.rngs = [np.random.default_rng(0)] * task.n

    def __init_subclass__(cls) -> None:
        """Derive the channel of a subclass that changes observations."""
        super().__init_subclass__()
        if "observe" in vars(cls) and "channels" not in vars(cls):
            cls.channels = frozenset({"observation"})

    def reaches(self, reads: Collection[str]) -> bool:
        """Return whether it reaches a policy that reads these of `observation` and `state`."""
        return not self.channels.isdisjoint({*reads, "action", "physics"})

    def undo(self, ids: NDArray[np.int32]) -> None:
        """Take back what `apply` has changed in worlds `ids`."""

    def apply(self, ids: NDArray[np.int32]) -> None:
        """Change the simulated robots of worlds `ids`, whose `levels` and `rngs` are those of their new episodes."""

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Prepare for the reset of worlds `ids`; their `rngs` are new."""

    def command(self, actions: Array) -> Array:
        """Return the actions that reach the robots, for `actions` (n, ...). Called once per control step, before it."""
        return actions

    def observe(self, observations: Observations, ids: NDArray[np.int32] | slice) -> Observations:
        """Return the observations that policies see in worlds `ids`. Repeated calls return the same."""
        return observations

    def perceive(self, numbers: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the state's numbers (n, k) for policies that see the state. Repeated calls return the same."""
        return numbers


@dataclass(frozen=True)
class LevelRange:
    """Levels from `low` to `high`."""

    low: float
    high: float
    whole: bool
    """True if levels are whole numbers."""

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a level uniformly, both ends included."""
        if self.whole:
            return float(rng.integers(int(self.low), int(self.high), endpoint=True))
        return float(rng.uniform(self.low, self.high))


def everywhere(task: Disturbable) -> bool:
    """Return True: it applies to every task."""
    return True


@dataclass(frozen=True)
class DisturbanceSpec:
    """Kind of disturbance for one kind of task."""

    make: Callable[[Any, float], Disturbance]
    """Makes the disturbance from the task and the level."""
    does: str
    """Effect, in one line."""
    unit: str
    levels: tuple[float, ...]
    """Default levels of a sweep, beginning with the one that changes nothing."""
    highest: float
    """Levels are from 0 to this."""
    whole: bool = False
    """True if levels are whole numbers."""
    applies: Callable[[Any], bool] = everywhere
    """Function of a task: whether it applies with the task's present options."""

    @property
    def neutral(self) -> float:
        """The level that changes nothing."""
        return float(self.levels[0])

    @property
    def strongest(self) -> float:
        """The allowed level that is farthest from the neutral one."""
        return 0.0 if self.neutral > 0 else self.highest

    def checked(self, name: str, level: object) -> float:
        """Return a level as a float. Raises `ConfigurationError` for an invalid level."""
        usable = isinstance(level, (int, float, np.number)) and not isinstance(level, bool)
        if not (usable and 0 <= level <= self.highest and (not self.whole or level == int(level))):  # type: ignore[operator, call-overload]
            number = "a whole number" if self.whole else "a number"
            raise ConfigurationError(f"{name} is {number} from 0 to {self.highest:g} ({self.unit}), not {level!r}")
        return float(level)  # type: ignore[arg-type]

    def checked_range(self, name: str, levels: object) -> LevelRange:
        """Return the range of a level, or of a pair of the lowest and highest. Raises `ConfigurationError`."""
        if not isinstance(levels, (list, tuple)):
            level = self.checked(name, levels)
            return LevelRange(level, level, self.whole)
        if len(levels) != 2:
            raise ConfigurationError(f"{name} is one level, or a pair of the lowest and the highest, not {levels!r}")
        low, high = (self.checked(name, level) for level in levels)
        if low > high:
            raise ConfigurationError(f"the levels of {name} are from the lowest to the highest, not {levels!r}")
        return LevelRange(low, high, self.whole)
