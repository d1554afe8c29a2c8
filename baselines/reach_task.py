"""Parts that the reach experts share: the check that they can work in an environment, and places for positions."""

from collections.abc import Iterable, Sequence
from typing import TypeVar

import numpy as np

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel, MinimumTimePose, MinimumTimeReach
from armctl.tasks import ReachOptions, ReachPoseOptions
from armctl.tasks.reach.pose import POSE_OBSERVATION

Options = TypeVar("Options", bound=ReachOptions)


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
    targets are positions, or with `poses`, maybe poses, whose observation begins with `POSE_OBSERVATION`.
    """
    has_poses = isinstance(env.options, ReachPoseOptions)
    if not isinstance(env.options, options) or (has_poses and not poses):
        raise ConfigurationError(f"{name} cannot play this task: use it with {env_id}")
    expected = list(POSE_OBSERVATION if has_poses else observation)
    if (parts := list(env.options.parts))[: len(expected)] != expected or env.options.goal:
        raise ConfigurationError(f"{name} reads the observation {', '.join(expected)}, not {', '.join(parts)}")
    if env.options.control not in controls:
        allowed = " or ".join(map(repr, controls))
        raise ConfigurationError(f"{name} needs control {allowed}, not {env.options.control!r}")
    return env.options


def search_for(model: ArmModel, task: ReachOptions) -> MinimumTimeReach:
    """Return the search for the task's targets, which also defines their places: positions, or poses."""
    return MinimumTimePose(model, task.lever) if isinstance(task, ReachPoseOptions) else MinimumTimeReach(model)


def split(search: MinimumTimeReach, observation: Array) -> tuple[Array, Array, Array, Array]:
    """Return the end-effector's place, joint positions (dof,), the target's place, and the rest of an observation."""
    dof = search.model.dof
    tip, q, target, rest = np.split(observation.astype(float), (3, 3 + dof, 6 + dof))
    if isinstance(search, MinimumTimePose):
        return search.centre(tip, rest[:6]), q, search.centre(target, rest[6:12]), rest[12:]
    return tip, q, target, rest
