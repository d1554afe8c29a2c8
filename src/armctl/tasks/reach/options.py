"""The options of `armctl/ArmReach-v0`, from which those of the other reach tasks are derived."""

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field, Strict

from armctl.core.errors import ConfigurationError
from armctl.core.options import Positive, options
from armctl.robot_description import ArmDescription
from armctl.tasks.reach.observation import OBSERVATIONS, WITHOUT_GOAL
from armctl.tasks.reach.state import GOAL_REWARD, REWARD, Term
from armctl.tasks.task import OneTimeTerm


def _ordered(box: "Box") -> "Box":
    if not all(low <= high for low, high in zip(*box, strict=True)):
        raise ValueError("a box is its lowest and highest corner (x, y, z)")
    return box


Corner = Annotated[tuple[float, float, float], Strict(False)]
Box = Annotated[tuple[Corner, Corner], Strict(False)]
Limit = Positive | Annotated[tuple[Positive, ...], Strict(False)] | None
Terms = Annotated[Mapping[str, Term], Field(min_length=1)]


@options
class ReachOptions:
    """Options of `armctl/ArmReach-v0`. Raises `ConfigurationError` for invalid values."""

    robot: str | Path | ArmDescription = "ur5"
    """`ur3`, `ur5`, `ur10`, a URDF, xacro or MJCF file, `menagerie:NAME`, or the result of `armctl.load_arm`."""
    tip: str | None = None
    """The end-effector's link, for a file in which several links could be it."""
    home: Annotated[tuple[float, ...], Strict(False)] | None = None
    """Joint positions in which episodes begin, rad. None: the default of `armctl.load_arm`."""
    max_velocity: Limit = None
    """Velocity limits of all joints or of each, rad/s: they lower a file's, and stand in for missing ones."""
    max_effort: Limit = None
    """The same of efforts, N m."""
    density: Positive | None = None
    """kg/m^3: of the shapes of links whose file has no possible mass or inertia."""
    control: Literal["position", "relative", "delta", "velocity", "torque"] = "position"
    """Control mode: the meaning of an action (see `armctl.robots.Arm`)."""
    tolerance: Positive = 0.05
    """Radius of the target sphere, m: within it, the target is reached."""
    target: Literal["reachable", "box"] = "reachable"
    """`reachable`: uniform over the arm's workspace. `box`: uniform in `target_box`, possibly out of reach (see
    `info["feasible"]`)."""
    target_box: Annotated[Box, AfterValidator(_ordered)] = ((-1.0, -1.0, 0.05), (1.0, 1.0, 1.0))
    """Lowest and highest corner of the box, m."""
    reward: Terms = field(default_factory=lambda: REWARD)
    """Named reward terms."""
    goal_reward: Annotated[float, Field(gt=0, le=1e6)] = GOAL_REWARD
    """Reward of the task's own term `goal`. With 1, success is worth 0 and every other step -1: then hindsight replay,
    which does not know that a success ends the episode, is right all the same."""
    observation: Literal["paper", "features", "full"] | Terms = "paper"
    """`paper`, `features`, `full` (see `armctl.tasks.reach.observation`), or named parts in order."""
    goal: bool = False
    """Observe a dict of `observation`, `achieved_goal` and `desired_goal`, for goal-conditioned learners."""

    observations: ClassVar[Mapping[str, Mapping[str, Term]]] = OBSERVATIONS
    """The parts of each named observation."""
    has_goals: ClassVar[bool] = True
    """True if the reward is a function of the goal, which `goal=True` needs."""

    def __post_init__(self) -> None:
        if self.goal and not self.has_goals:
            raise ConfigurationError("goal=True needs a reward that depends on the goal alone: use armctl/ArmReach-v0")
        if self.goal and not isinstance(self.observation, str):
            raise ConfigurationError("with goal=True, the observation is one of paper, features and full")
        _ = self.reward_functions
        if self.goal and self.reward is not REWARD:
            raise ConfigurationError(
                "with goal=True, the reward is the task's own: it has to be a function of the goal"
            )

    @property
    def reward_functions(self) -> Mapping[str, Term]:
        """Named reward terms, with `goal_reward`."""
        if self.goal_reward == GOAL_REWARD:
            return self.reward
        goal, share = self.reward.get("goal"), self.goal_reward / GOAL_REWARD
        if not isinstance(goal, OneTimeTerm) or goal.bounds != (0.0, GOAL_REWARD):
            raise ConfigurationError("goal_reward is for the task's own reward, not for named terms")
        return {**self.reward, "goal": OneTimeTerm(lambda state: share * goal(state), (0.0, self.goal_reward))}

    @property
    def parts(self) -> Mapping[str, Term]:
        """Named parts of the observation, in order."""
        if not isinstance(self.observation, str):
            return self.observation
        return (WITHOUT_GOAL if self.goal else self.observations)[self.observation]
