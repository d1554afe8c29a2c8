"""What a task is: everything that environments, experts, learners and reports need to know about it, in one class."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, ClassVar, Self

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.disturbances import GENERIC, DisturbanceSpec
from armctl.errors import ConfigurationError
from armctl.options import options
from armctl.robots.joints import JointSamples
from armctl.simulation import Simulation

Array = NDArray[np.float64]
Ids = NDArray[np.int32]
"""Which worlds: indices."""
RewardTerms = dict[str, Array]
"""Named reward terms, (n,) each; the reward is their sum."""
Observations = NDArray[np.float32] | dict[str, NDArray[Any]]
"""Of n worlds, (n, ...): one array, or several by name."""


class Outcome(IntEnum):
    """How an episode ends. Subclasses have the members: `TIMEOUT = 0`, and `REACHED = 1, True` for a success."""

    success: bool

    def __new__(cls, value: int, success: bool = False) -> Self:
        """A member from its value, and whether it is a success."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.success = success
        return member

    @property
    def label(self) -> str:
        """The name that users see."""
        return self.name.lower()


@dataclass(frozen=True)
class MotionSample:
    """How n robots move, and what acts on them."""

    position: Array
    """(n, 3) m: end-effectors, or mobile bases."""
    configuration: Array
    """(n, k): joint positions, rad, or the pose x, y (m) and yaw (rad)."""
    contact: NDArray[np.bool_]
    """(n,) whether the robot touched something that it must not touch."""
    joints: Array | None = None
    """(2, samples, n, joints) speeds (rad/s) and torques (N m) of joints or wheels since the last control step."""


@dataclass(frozen=True)
class FeatureSpec:
    """What a network is shown of an observation: features by their name in `armctl.rl.features`, and their options."""

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class LearnerView:
    """How learners see a task and act in it, in plain values: learners make networks of them."""

    action_low: NDArray[Any]
    """What -1 of a network's action means, in the environment's action space."""
    action_high: NDArray[Any]
    """What 1 means."""
    relative_to: slice | None = None
    """The part of the observation that actions may be relative to, if any."""
    largest_move: float = 0.0
    """Largest relative action, in each number."""
    features: FeatureSpec | None = None
    """None: the bare observation."""
    invariant_features: FeatureSpec | None = None
    """The same in a frame in which symmetries of the task change nothing, if there is one."""


class Potential(ABC):
    """A potential of n worlds, for reward shaping: a function of the state alone, the same one for a whole episode."""

    def __init__(self, task: Any) -> None:
        self.task = task

    def begin(self, ids: Ids) -> None:  # noqa: B027
        """Worlds `ids` have begun a new episode: prepare for it, if there is anything to prepare."""

    @abstractmethod
    def potentials(self, ids: Ids) -> Array:
        """Potentials of worlds `ids` as they are now, (len(ids),): the higher, the nearer to the goal."""


class GoalDistance(Potential):
    """Minus the distance to the goal, m: the naive potential, for comparison."""

    def potentials(self, ids: Ids) -> Array:
        """In m, (len(ids),)."""
        return -np.asarray(self.task.goal_distances()[ids])


@options
class NoOptions:
    """For tasks without options."""


class Task(ABC):
    """n worlds with a job. All arrays carry a leading axis n, the number of worlds.

    A subclass is made with `(n, options, threads)`. It sets `observation_space` and `action_space`, those of one world,
    and hands its simulation to this class's constructor. `docs/add_a_task.md` has a complete example.

    Raises `ConfigurationError` for a subclass that declares something unusable.
    """

    options_type: ClassVar[type[Any]] = NoOptions
    """Dataclass of the options, with defaults; `armctl.options.options` makes one that checks its values."""
    outcomes: ClassVar[type[Outcome]]
    """How episodes can end: `TIMEOUT = 0`, then 1, 2 and so on."""
    default_policies: ClassVar[tuple[str, ...]] = ("random",)
    """Those that `armctl compare` lines up if none are named."""
    disturbances: ClassVar[Mapping[str, DisturbanceSpec]] = GENERIC
    """What may go wrong, by name."""
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {"distance": GoalDistance}
    """Potentials for reward shaping, by name: each is made from the task."""
    camera: ClassVar[str] = "overview"
    """The MJCF camera that pictures are taken with."""
    render_fps: ClassVar[int] = 25
    """Control steps in a second, for videos in real time."""

    observation_space: gymnasium.spaces.Space[Any]
    """Of one world."""
    action_space: gymnasium.spaces.Box
    """Of one world."""
    joints: JointSamples | None = None
    """Speeds and torques beside their limits, for metrics."""

    def __init__(self, simulation: Simulation, control_period: float) -> None:
        self.simulation = simulation
        self.n = simulation.n
        self.substeps = round(control_period / simulation.model.opt.timestep)
        """Physics steps between two control steps."""

    def __init_subclass__(cls) -> None:
        """Check the outcomes that a subclass declares."""
        super().__init_subclass__()
        names = {one.value: one.name for one in getattr(cls, "outcomes", ())}
        if names and (sorted(names) != list(range(len(names))) or names[0] != "TIMEOUT"):
            raise ConfigurationError(
                f"the outcomes of {cls.__name__} are TIMEOUT = 0, then 1, 2 and so on, not {names}"
            )

    @abstractmethod
    def reset(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        """Start new episodes in worlds `ids`, each sampled from its own generator alone."""

    @abstractmethod
    def command(self, actions: Array) -> None:
        """Hand actions (n, ...) to the robots; they act on the simulation's next steps."""

    @abstractmethod
    def observe(self, ids: Ids | None = None) -> Observations:
        """What policies see now, in worlds `ids` or in all."""

    @abstractmethod
    def reward_terms(self) -> RewardTerms:
        """What the last control step earned. Called once after each `advance`."""

    @abstractmethod
    def outcome(self) -> NDArray[np.integer[Any]]:
        """(n,) values of `outcomes`: 0 as long as an episode has not ended."""

    def advance(self, ids: Ids | None) -> None:
        """Simulate until the next control step, in worlds `ids` or in all."""
        self.simulation.step(self.substeps, ids)

    @property
    def control_period(self) -> float:
        """Seconds between two control steps."""
        return float(self.substeps * self.simulation.model.opt.timestep)

    @property
    def interface(self) -> dict[str, str]:
        """What a policy is made for: a learned one must have been trained on the same."""
        return {"task": type(self).__name__}

    @property
    def idle_action(self) -> Array:
        """The action that leaves the robot where it starts."""
        return np.zeros(self.action_space.shape)

    @property
    def payload_body(self) -> str:
        """The body that carries a payload and that pushes act on."""
        raise ConfigurationError(f"{type(self).__name__} does not say which body carries a payload (payload_body)")

    @property
    def learner_view(self) -> LearnerView:
        """How learners see the task and act in it: the bare observation, and the whole action space."""
        return LearnerView(self.action_space.low, self.action_space.high)

    def observation_parts(self) -> dict[str, NDArray[Any]]:
        """What is observed now, by name, (n, ...) each; for people."""
        observed = self.observe()
        return observed if isinstance(observed, dict) else {"observation": observed}

    def info(self) -> dict[str, Any]:
        """What `info` says in addition: arrays (n,), or dicts of such arrays."""
        return {}

    def motion(self) -> MotionSample:
        """How the robots move now, in arrays of their own; positions are NaN where a task does not tell them."""
        return MotionSample(
            np.full((self.n, 3), np.nan), self.simulation.array("qpos").copy(), np.zeros(self.n, dtype=bool)
        )

    def goal_distances(self) -> Array:
        """(n,) m from the robot to its goal; NaN where that is not known."""
        return np.full(self.n, np.nan)

    def least_clearance(self, world: int, configurations: Array) -> float:
        """Least distance, m, over `MotionSample.configuration` (steps, k) of an episode that has just ended in a world.

        From the robot to whatever it must not touch; NaN where that is not known.
        """
        return math.nan

    def least_time(self, world: int) -> float:
        """Seconds that every policy needs at least for a success from here; NaN where that is not known."""
        return math.nan


def check_reward_terms(terms: RewardTerms, n: int) -> None:
    """Raise `ConfigurationError` for a reward term that is not one number for each of n worlds."""
    for name, earned in terms.items():
        if earned.shape != (n,):
            raise ConfigurationError(f"the reward term {name!r} is one number a world, ({n},), not {earned.shape}")
