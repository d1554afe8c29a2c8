"""The base class of tasks: everything that environments, experts, learners and reports need to know about a task."""

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar, Self

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array, Observations
from armctl.core.errors import ConfigurationError
from armctl.core.options import options
from armctl.disturbances import GENERIC, DisturbanceSpec
from armctl.robots.joints import JointSamples
from armctl.simulation import Simulation
from armctl.simulation.planning_model import Connect
from armctl.tasks.goals import Goals
from armctl.tasks.learner_view import LearnerView

Ids = NDArray[np.int32]
"""Indices of worlds."""
RewardTerms = dict[str, Array]
"""Named reward terms, (n,) each; the reward is their sum."""


class Outcome(IntEnum):
    """Outcome of an episode. Subclasses have the members: `TIMEOUT = 0`, and `REACHED = 1, True` for a success."""

    success: bool

    def __new__(cls, value: int, success: bool = False) -> Self:
        """Return a member from its value, and whether it is a success."""
        member = int.__new__(cls, value)
        member._value_ = value
        member.success = success
        return member

    @property
    def label(self) -> str:
        """The name in results and reports."""
        return self.name.lower()


@dataclass(frozen=True)
class MotionSample:
    """The motion of n robots since the last control step."""

    position: Array
    """(n, 3) m: end-effectors, or mobile bases."""
    configuration: Array
    """(n, k): joint positions, rad, or the pose x, y (m) and yaw (rad)."""
    contact: NDArray[np.bool_] | None
    """(n,) whether the robot had a forbidden contact; None if unknown."""
    joints: Array | None = None
    """(2, samples, n, joints) speeds (rad/s) and torques (N m) of joints or wheels since the last control step."""
    path: Array | None = None
    """(samples, n, 3) m: where an end-effector was at the same times."""


class Potential(ABC):
    """A potential for reward shaping, of n worlds: a function of the state only, fixed during an episode."""

    def __init__(self, task: Any) -> None:
        self.task = task

    def begin(self, ids: Ids) -> None:  # noqa: B027
        """Prepare for the new episodes of worlds `ids`."""

    @abstractmethod
    def potentials(self, ids: Ids) -> Array:
        """Return potentials of the present states of worlds `ids`, (len(ids),). They are higher nearer to the goal."""


class GoalDistance(Potential):
    """Minus the distance to the goal, m. This is the naive potential, for comparison."""

    def potentials(self, ids: Ids) -> Array:
        """Return (len(ids),) m."""
        return -np.asarray(self.task.goal_distances()[ids])


@dataclass(frozen=True)
class OneTimeTerm:
    """A reward term that is paid once an episode: the first time that it is not 0."""

    term: Callable[[Any], NDArray[np.floating[Any]]]
    """A function of the state of n worlds."""
    bounds: tuple[float, float] | None = None
    """The least and the most that it can pay, if known."""

    def __call__(self, state: Any) -> NDArray[np.floating[Any]]:
        """Return what it would pay in the present state, (n,)."""
        return self.term(state)


@dataclass(frozen=True)
class EachStep:
    """A reward term that is paid at each control step, and whose bounds are known: a plain function has none."""

    term: Callable[[Any], NDArray[np.floating[Any]]]
    """A function of the state of n worlds."""
    bounds: tuple[float, float]
    """The least and the most that it can pay in a step."""

    def __call__(self, state: Any) -> NDArray[np.floating[Any]]:
        """Return what it pays in the present state, (n,)."""
        return self.term(state)


@options
class NoOptions:
    """Options of tasks without options."""


class TaskFacts(ABC):
    """Facts that evaluation and viewers ask about n worlds; here, the answers where nothing is known."""

    interface_options: ClassVar[frozenset[str]] = frozenset()
    """Options that say how a policy sees and commands the robot. A learned agent brings its own."""
    instruction: ClassVar[str] = ""
    """Instruction for the robot, as a sentence for models that take language; empty: unknown."""
    foresight: tuple[str, ...] = ()
    """Things that change by themselves in an episode, so that policies may foresee them: `target`, `pedestrians`."""
    granted: tuple[str, ...] | None = None
    """Foresight of the policy that acts at present; None while none does."""
    n: int

    @property
    def robot(self) -> Any:
        """The robot's description, for policies that use a model of it; None if there is none."""
        return None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes that belong into every result: what the reader of the robot's file assumed, for instance."""
        return tuple(getattr(self.robot, "notes", ()))

    @property
    def physical(self) -> bool:
        """True if masses, friction and pushes change anything."""
        return True

    def static_map(self, world: int) -> Any:
        """Return a copy of what stands still around the robot in the current episode, for policies that see the map."""
        return None

    def preview(self, name: str, world: int) -> Any:
        """Return the future of one of `foresight` in the current episode, for policies that declare to foresee it.

        It has `positions(times)`, times in s since the episode's start, and is a copy.
        """
        return None

    @abstractmethod
    def observe(self) -> Observations:
        """Return present observations of all worlds."""

    def observation_parts(self) -> dict[str, NDArray[Any]]:
        """Return the present observation's parts by name, (n, ...) each; for display."""
        observed = self.observe()
        return observed if isinstance(observed, dict) else {"observation": observed}

    def info(self) -> dict[str, Any]:
        """Return additional entries of the environment's `info`: arrays (n,), or dicts of such arrays."""
        return {}

    def goal_distances(self) -> Array:
        """Return the distances (n,) from the robot to its goal, m; NaN if unknown."""
        return np.full(self.n, np.nan)

    def min_clearance(self, world: int, configurations: Array) -> float:
        """Return the least distance (m) of the robot from anything it must not touch in an episode; NaN if unknown.

        `configurations` (steps, k) are the `MotionSample.configuration` of the episode that has just ended in `world`.
        """
        return math.nan

    def return_bounds(self, steps: int | None) -> tuple[float, float] | None:
        """Return least and largest possible return of an episode of at most `steps` control steps; None if unknown."""
        return None

    def min_time(self, world: int) -> float:
        """Lower bound on the time to success from the present state, s; NaN if unknown."""
        return math.nan


class Task(TaskFacts):
    """A task in n worlds. All arrays carry a leading axis n, the number of worlds.

    A subclass is made with `(n, options, threads)`. It sets `observation_space` and `action_space`, those of one world,
    and passes its simulation to this class's constructor. `docs/add_a_task.md` has a complete example.

    Raises `ConfigurationError` for a subclass with invalid declarations.
    """

    options_type: ClassVar[type[Any]] = NoOptions
    """Dataclass of the options, with defaults. `armctl.core.options.options` makes it check its values."""
    outcomes: ClassVar[type[Outcome]]
    """Possible outcomes of episodes: `TIMEOUT = 0`, then 1, 2 and so on."""
    default_policies: ClassVar[tuple[str, ...]] = ("random",)
    """The default line-up of `armctl compare`."""
    disturbances: ClassVar[Mapping[str, DisturbanceSpec]] = GENERIC
    """Disturbances that apply to the task, by name."""
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {"distance": GoalDistance}
    """Potentials for reward shaping, by name: functions from the task to a `Potential`."""
    interface_options = frozenset({"actions", "reward_scale", "reward_weights"})
    camera: ClassVar[str] = "overview"
    """The MJCF camera of videos and images."""
    render_fps: ClassVar[int] = 25
    """Control steps per second, for videos in real time."""

    observation_space: gymnasium.spaces.Space[Any]
    """Observation space of one world."""
    action_space: gymnasium.spaces.Box
    """Action space of one world."""
    state_space: gymnasium.spaces.Box | None = None
    """Space of `state_observation`, of one world; None: the task does not say its state."""
    reward_functions: Mapping[str, Any] = {}
    """The reward terms by name, as functions, `OneTimeTerm` or `EachStep`, if the task has them like this."""
    rollout_worlds: Connect | None = None
    """Maker of worlds in which policies that foresee the `simulator` roll actions out, as `command` and `advance` move
    the robot; None: unknown. It can be pickled: a partial function, such as
    `functools.partial(motor_worlds, substeps=self.substeps)` of `armctl.simulation.planning_model`."""
    joints: JointSamples | None = None
    """Speeds and torques, and their limits, for metrics; None if the task does not sample them."""

    def __init__(self, simulation: Simulation, control_period: float) -> None:
        self.simulation = simulation
        self.n = simulation.n
        self.substeps = round(control_period / simulation.model.opt.timestep)
        """Physics steps between two control steps."""

    def __init_subclass__(cls) -> None:
        """Check the subclass's outcomes."""
        super().__init_subclass__()
        names = {member.value: member.name for member in getattr(cls, "outcomes", ())}
        if names and (sorted(names) != list(range(len(names))) or names[0] != "TIMEOUT"):
            raise ConfigurationError(
                f"the outcomes of {cls.__name__} must be TIMEOUT = 0, then 1, 2 and so on, not {names}"
            )

    @abstractmethod
    def reset(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        """Start new episodes in worlds `ids`. Each is sampled from its own generator only."""

    @abstractmethod
    def command(self, actions: Array) -> None:
        """Pass actions (n, ...) to the robots. They take effect when the simulation advances."""

    @abstractmethod
    def observe(self, ids: Ids | None = None) -> Observations:
        """Return observations of worlds `ids`, or of all."""

    def state_observation(self, ids: Ids | None = None) -> NDArray[np.float32]:
        """Return the state of worlds `ids`, or of all, (n, k), as the option `observation="state"` shows it.

        It is for the critics and teachers of learners, whatever agents observe. Raises `ConfigurationError` if unknown.
        """
        raise ConfigurationError(f"{type(self).__name__} has no observation of its state (state_observation)")

    @abstractmethod
    def reward_terms(self) -> RewardTerms:
        """Return reward terms of the last control step. Called once after each `advance`."""

    @abstractmethod
    def outcome(self) -> NDArray[np.integer[Any]]:
        """Return (n,) values of `outcomes`; 0 while an episode goes on."""

    def advance(self, ids: Ids | None) -> None:
        """Simulate until the next control step, in worlds `ids` or in all."""
        self.simulation.step(self.substeps, ids)

    @functools.cached_property
    def paid_once(self) -> frozenset[str]:
        """Names of the reward terms that are paid once an episode."""
        return frozenset(name for name, term in self.reward_functions.items() if isinstance(term, OneTimeTerm))

    def return_bounds(self, steps: int | None) -> tuple[float, float] | None:
        """Return bounds from those of all reward terms; None unless each has some."""
        lowest = highest = 0.0
        for term in self.reward_functions.values():
            if steps is None or (bounds := getattr(term, "bounds", None)) is None:
                return None
            low, high = bounds
            times = 1 if isinstance(term, OneTimeTerm) else steps
            lowest, highest = lowest + min(low, low * times), highest + max(high, high * times)
        return (lowest, highest) if self.reward_functions else None

    @property
    def control_period(self) -> float:
        """Seconds between two control steps."""
        return float(self.substeps * self.simulation.model.opt.timestep)

    @property
    def interface(self) -> dict[str, str]:
        """Facts that a learned policy depends on, such as robot and control: the same as in its training."""
        return {"task": type(self).__name__}

    @property
    def idle_action(self) -> Array:
        """The action that leaves the robot where it starts."""
        return np.zeros(self.action_space.shape)

    @property
    def payload_body(self) -> str:
        """The body to which payloads are attached and pushes are applied."""
        raise ConfigurationError(f"{type(self).__name__} does not say which body carries a payload (payload_body)")

    @property
    def learner_view(self) -> LearnerView:
        """Features and relative actions for learners: by default the bare observation, and none."""
        return LearnerView()

    @property
    def goals(self) -> Goals | None:
        """Goals for hindsight of the class that declares them, as success in a subclass may be another; else None."""
        return None

    @property
    def action_range(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """The actions that -1 and 1 of a learner's normalized actions stand for: by default, the space's bounds."""
        return self.action_space.low, self.action_space.high

    def motion(self) -> MotionSample:
        """Return the present motion, in new arrays. Positions are NaN unless a subclass overrides this."""
        return MotionSample(
            np.full((self.n, 3), np.nan), self.simulation.array("qpos").copy(), np.zeros(self.n, dtype=bool)
        )


def check_reward_terms(terms: RewardTerms, n: int) -> None:
    """Raise `ConfigurationError` for a reward term that is not one number for each of n worlds."""
    for name, rewards in terms.items():
        if rewards.shape != (n,):
            raise ConfigurationError(f"the reward term {name!r} must have shape ({n},), not {rewards.shape}")
