"""A learned agent guides a planner: it proposes moves of imagined arms, of which those free of collisions are made.

`reach_ompl` plans with a search by OMPL. Here, an agent takes its place: it moves copies of the arm from the start on,
all but the very first with noise, and a copy makes only moves that keep the clearance. The first that sees a
configuration in which the target is reached ends the search. This is planning with a learned sampler (Qureshi et al.,
"Motion Planning Networks: bridging the gap between learning-based and classical motion planners", IEEE Transactions on
Robotics 37(1), 2021). All else is that of `reach_ompl`: straight motions where there are, shortcuts, and the way the
path is executed on estimates.
"""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from armctl.agents import OnnxPolicy
from armctl.baselines.reach_ompl import PreparedReachOmpl
from armctl.baselines.reach_task import checked_options
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, NonNegative, Positive, changed_options, options
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel, EdgeChecker, MinimumTimePose
from armctl.planning import ArmPlanner, ArmPlannerOptions
from armctl.policies import PerWorld, made_for, make_policy, sees
from armctl.scene import Boxes
from armctl.tasks import ReachObstaclesOptions
from armctl.tasks.reach import CONTROL_PERIOD
from armctl.tasks.reach.obstacles import OBSTACLES_OBSERVATION, obstacles_observation

NEAREST = 4
"""Goals, the nearest ones, to which each copy tries a straight motion after a move."""


@options
class GuideOptions:
    """Options of the search."""

    copies: Count = 16
    """Imagined copies of the arm in a round; the first of all moves without noise."""
    rounds: Count = 4
    """Rounds until the search gives up."""
    steps: Count = 60
    """Moves of a copy."""
    noise: NonNegative = 0.15
    """Standard deviation of what is added to each joint's move, rad."""
    largest_move: Positive = 0.3
    """Largest move of a joint, rad."""


@made_for("armctl/ArmReachObstacles-v0", controls="ur5: position")
@sees("model", family="imagination", kind="hybrid")
def make_obstacles(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> "GuidedPolicy":
    """`reach_ompl` with `obstacles_plan_bc` in place of OMPL's search: it proposes the moves of imagined arms."""
    return guided("obstacles_imagined", "obstacles_plan_bc", env, options)


@made_for("armctl/ArmScenes-v0", controls="ur5_robotiq85: position")
@sees("model", family="imagination", kind="hybrid")
def make_scenes(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> "GuidedPolicy":
    """`reach_ompl` with `scenes_plan_bc` in place of OMPL's search: it proposes the moves of imagined arms."""
    return guided("scenes_imagined", "scenes_plan_bc", env, options)


def guided(name: str, guide: str | Path, env: ModelInterface, options: Mapping[str, Any]) -> "GuidedPolicy":
    """Return the policy called `name`, with an agent as guide: its name, or the path of its card.

    Raises `ConfigurationError` for wrong options and for another task, and what `make_policy` raises.
    """
    choice = changed_options(GuideOptions(), options, f"option of {name}")
    agent = make_policy(guide, env)
    if not isinstance(agent, OnnxPolicy) or agent.card.memory:
        raise ConfigurationError(f"{name}: only an agent without a memory guides, and {guide} is none")
    task = checked_options(
        name, env, ReachObstaclesOptions, "the task of its agent", OBSTACLES_OBSERVATION, ["position"], poses=True
    )
    model, clocks = ArmModel(env.robot), (functools.partial(env.control_step, i) for i in range(env.num_envs))
    controllers = [GuidedReach(agent, choice, model, task, CONTROL_PERIOD, clock) for clock in clocks]
    return GuidedPolicy(controllers, agent)


class GuidedPolicy(PerWorld):
    """One controller for each world, which all have the same guide."""

    def __init__(self, controllers: Sequence["GuidedReach"], agent: OnnxPolicy) -> None:
        super().__init__(controllers, prepared=True)
        self.card, self.training_steps, self.training_cost = agent.card, agent.training_steps, agent.training_cost


class GuidedPlanner(ArmPlanner):
    """Plans to one place among boxes, which the agent observes as `target` (9,) or (3,), and `boxes` (k,)."""

    def __init__(self, agent: OnnxPolicy, guidance: GuideOptions, target: Array, boxes: Array, *setting: Any) -> None:
        super().__init__(*setting)
        self._agent, self._guidance = agent, guidance
        self._observed = [np.tile(numbers, (guidance.copies, 1)) for numbers in (target, boxes)]

    def _search(self, edges: EdgeChecker, start: Array, goals: Array) -> Array:
        choice, limits, rng = self._guidance, self.model.limits, np.random.default_rng(self.options.seed)
        for number in range(choice.rounds):
            paths = [[start] for _ in range(choice.copies)]
            for _ in range(choice.steps):
                q = np.array([path[-1] for path in paths])
                noise = rng.normal(scale=choice.noise, size=q.shape)
                noise[0] *= number > 0
                moves = self._agent.act(obstacles_observation(self.model, q, *self._observed)) - q + noise
                moves *= np.minimum(1.0, choice.largest_move / np.maximum(abs(moves).max(axis=1, keepdims=True), 1e-9))
                for path, end in zip(paths, np.clip(q + moves, limits.lower, limits.upper), strict=True):
                    if edges.is_edge_free(path[-1], end):
                        path.append(end)
                        if (goal := _in_sight(edges, end, goals)) is not None:
                            return np.array((*path, goal))
        return np.zeros((0, self.model.dof))


def _in_sight(edges: EdgeChecker, q: Array, goals: Array) -> Array | None:
    """Return one of the goals (k, dof) nearest to `q` (dof,) to which the straight motion is free, if any."""
    nearest = goals[np.argsort(((goals - q) ** 2).sum(axis=1))[:NEAREST]]
    return next((goal for goal in nearest if edges.is_edge_free(q, goal)), None)


class GuidedReach(PreparedReachOmpl):
    """Reaches with one arm."""

    def __init__(self, agent: OnnxPolicy, guidance: GuideOptions, *setting: Any) -> None:
        self._agent, self._guidance = agent, guidance
        super().__init__(*setting)

    def _planner(self, options: ArmPlannerOptions, target: Array, boxes: Boxes) -> ArmPlanner:
        search = self._search
        axes = search.pose(target)[:3, :2].T if isinstance(search, MinimumTimePose) else ()
        numbers = np.zeros((self._task.max_boxes, self._task.box_numbers))
        numbers[: len(boxes)] = boxes.numbers
        place = np.concatenate((target[:3], *axes))
        return GuidedPlanner(self._agent, self._guidance, place, numbers.ravel(), self._model, options, search)
