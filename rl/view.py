"""How networks see a task and act in it: the same for every learner."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium
import torch
from armctl.rl.bridge import BridgeFeatures, VelocityScale
from armctl.rl.reach import ActionScale, ReachFeatures
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, CombinedExtractor, FlattenExtractor

from armctl.envs import TaskVectorEnv
from armctl.errors import ConfigurationError
from armctl.tasks import OBSERVATION, BridgeTask, ReachTask


@dataclass(frozen=True)
class View:
    """What a network is shown of a task, and how it acts."""

    action_scale: torch.nn.Module
    """From observations and the network's actions in [-1, 1] to the environment's actions."""
    features: type[BaseFeaturesExtractor]
    features_options: dict[str, Any] = field(default_factory=dict)


def view_of(worlds: TaskVectorEnv, *, features: bool = True, relative: bool = True) -> View:
    """The view of a task; without `features`, of the bare observation. `relative` is for arms: see `ActionScale`.

    Raises `ConfigurationError` for a task that there is no view of.
    """
    task, space, actions = worlds.task, worlds.single_observation_space, worlds.single_action_space
    bare = CombinedExtractor if isinstance(space, gymnasium.spaces.Dict) else FlattenExtractor
    if isinstance(task, ReachTask):
        if list(task.options.observation)[: len(OBSERVATION)] != list(OBSERVATION):
            raise ConfigurationError(f"learners need an observation that begins with {', '.join(OBSERVATION)}")
        scale = ActionScale(task.interface["control"], actions, relative)
        return View(scale, ReachFeatures, {"dof": actions.shape[0]}) if features else View(scale, bare)
    if isinstance(task, BridgeTask):
        depth = task.options.observation == "camera" and task.options.camera == "depth"
        return View(VelocityScale(), BridgeFeatures if features and depth else bare)
    raise ConfigurationError(f"learners have no view of {type(task).__name__} yet")
