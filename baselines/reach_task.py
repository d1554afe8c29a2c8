"""Parts that the reach experts share: the check that they can work in an environment, and places for positions."""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel, MinimumTimePose, MinimumTimeReach
from armctl.scene import Boxes
from armctl.tasks import ReachObstaclesOptions, ReachOptions, ReachPoseOptions
from armctl.tasks.reach import read_boxes
from armctl.tasks.reach.pose import POSE_OBSERVATION

Options = TypeVar("Options", bound=ReachOptions)
CLEARANCES = (0.01, 0.0075, 0.005)
"""m, of paths: of the first plan, and of the next ones if it fails. Layouts are certified with the last."""
POSE_CLEARANCES = (0.01, 0.005, 0.0025)
"""m, for poses, in which an open hand is next to what it is to grasp."""
POSE_SEARCH: Mapping[str, Any] = MappingProxyType({"checks": 20_000, "stride": 0.5})
"""Options of a search for a pose, which has few configurations: longer, and in shorter edges."""


def checked_options(
    name: str,
    env: ModelInterface,
    options: type[Options],
    env_id: str,
    observation: Iterable[str],
    controls: Sequence[str],
    poses: bool = False,
) -> Options:
    """Return the task's options; raises `ConfigurationError` unless the task suits the expert called `name`.

    It has to be one with `options`, whose observation begins with the parts `observation`, with one of `controls`. Its
    targets are positions, or with `poses`, maybe poses, which have `POSE_OBSERVATION` in place of `OBSERVATION`.
    """
    has_poses = isinstance(env.options, ReachPoseOptions)
    if not isinstance(env.options, options) or (has_poses and not poses):
        raise ConfigurationError(f"{name} cannot play this task: use it with {env_id}")
    expected = list({**POSE_OBSERVATION, **dict.fromkeys(observation)} if has_poses else observation)
    if (parts := list(env.options.parts))[: len(expected)] != expected or env.options.goal:
        raise ConfigurationError(f"{name} reads the observation {', '.join(expected)}, not {', '.join(parts)}")
    if env.options.control not in controls:
        allowed = " or ".join(map(repr, controls))
        raise ConfigurationError(f"{name} needs control {allowed}, not {env.options.control!r}")
    return env.options


def search_for(model: ArmModel, task: ReachOptions) -> MinimumTimeReach:
    """Return the search for the task's targets, which also defines their places: positions, or poses."""
    return MinimumTimePose(model, task.lever) if isinstance(task, ReachPoseOptions) else MinimumTimeReach(model)


def planning(task: ReachOptions) -> tuple[tuple[float, ...], Mapping[str, Any]]:
    """Return the clearances (m) to plan with, one after the other, and further options of `ArmPlannerOptions`."""
    return (POSE_CLEARANCES, POSE_SEARCH) if isinstance(task, ReachPoseOptions) else (CLEARANCES, {})


def boxes_reader(task: ReachOptions) -> Callable[[Array], Boxes] | None:
    """Return what reads the boxes of an observation, the last of its parts; None if the task has none."""
    if not isinstance(task, ReachObstaclesOptions):
        return None
    return functools.partial(read_boxes, box_numbers=task.box_numbers)


def split(search: MinimumTimeReach, observation: Array) -> tuple[Array, Array, Array, Array]:
    """Return the end-effector's place, joint positions (dof,), the target's place, and the rest of an observation."""
    dof = search.model.dof
    tip, q, target, rest = np.split(observation.astype(float), (3, 3 + dof, 6 + dof))
    if isinstance(search, MinimumTimePose):
        return search.centre(tip, rest[:6]), q, search.centre(target, rest[6:12]), rest[12:]
    return tip, q, target, rest
