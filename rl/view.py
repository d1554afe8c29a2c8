"""How networks see a task and act in it: the same for every learner."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
import torch
from armctl.rl.bridge import BridgeFeatures, VelocityScale
from armctl.rl.reach import ActionScale, ReachFeatures, TurnedFeatures
from armctl.rl.reach import turned as turned_by
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, CombinedExtractor, FlattenExtractor

from armctl.envs import TaskVectorEnv
from armctl.errors import ConfigurationError
from armctl.kinematics import ArmModel
from armctl.tasks import OBSERVATION, BridgeTask, ReachTask


@dataclass(frozen=True)
class View:
    """What a network is shown of a task, and how it acts."""

    action_scale: torch.nn.Module
    """From observations and the network's actions in [-1, 1] to the environment's actions."""
    features: type[BaseFeaturesExtractor]
    features_options: dict[str, Any] = field(default_factory=dict)


def view_of(worlds: TaskVectorEnv, *, features: bool = True, relative: bool = True, turned: bool = False) -> View:
    """The view of a task; without `features`, of the bare observation.

    For arms: `relative` (see `ActionScale`), and `turned` (see `TurnedFeatures`), where the first axis is vertical.

    Raises `ConfigurationError` for a task that there is no view of.
    """
    task, space, actions = worlds.task, worlds.single_observation_space, worlds.single_action_space
    bare = CombinedExtractor if isinstance(space, gymnasium.spaces.Dict) else FlattenExtractor
    if isinstance(task, ReachTask):
        if list(task.options.observation)[: len(OBSERVATION)] != list(OBSERVATION):
            raise ConfigurationError(f"learners need an observation that begins with {', '.join(OBSERVATION)}")
        scale = ActionScale(task.interface["control"], actions, relative)
        if not features:
            return View(scale, bare)
        dof = actions.shape[0]
        if not (turned and _turns_about_vertical(ArmModel(task.arm.description))):
            return View(scale, ReachFeatures, {"dof": dof})
        parts = {name: part.shape[1] for name, part in list(task.parts().items())[len(OBSERVATION) :]}
        return View(scale, TurnedFeatures, {"dof": dof, "parts": parts})
    if isinstance(task, BridgeTask):
        depth = task.options.observation == "camera" and task.options.camera == "depth"
        return View(VelocityScale(), BridgeFeatures if features and depth else bare)
    raise ConfigurationError(f"learners have no view of {type(task).__name__} yet")


def _turns_about_vertical(model: ArmModel) -> bool:
    """Whether turning the first joint turns the end-effector about the vertical through the origin."""
    q = model.home + np.array([[0.3], [0.3]])
    q[1, 0] += 1.0
    before, after = torch.as_tensor(model.positions(q))
    return bool(torch.allclose(turned_by(before, torch.ones(1, dtype=before.dtype)), after, atol=1e-4))
