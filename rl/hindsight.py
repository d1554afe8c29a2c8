"""Hindsight experience replay (Andrychowicz et al. 2017) for the reach task, by Stable-Baselines3's buffer.

An episode that missed its target has reached other positions: with one of them as the target, it is a success.
"""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

from armctl.rl.vector import StableBaselinesVectorEnv
from armctl.rl.view import View
from armctl.tasks.reach import observation_slices
from armctl.tasks.reach.state import GOAL_REWARD, STEP_REWARD

PARTS = {
    "achieved_goal": "end_effector_position",
    "observation": "joint_positions",
    "desired_goal": "target_position",
}
"""Names of a goal-conditioned environment for the parts of the task's observation, in the task's order."""


def split(observations: Any, dof: int) -> dict[str, Any]:
    """The task's observations (..., 6 + dof), arrays or tensors, as those of a goal-conditioned environment."""
    slices = observation_slices(dof)
    return {name: observations[..., slices[part]] for name, part in PARTS.items()}


class GoalVectorEnv(StableBaselinesVectorEnv):
    """Reach worlds with `achieved_goal`, the end-effector's position, and `desired_goal`, the target's (m)."""

    def __init__(self, tolerance: float, *args: Any) -> None:
        super().__init__(*args)
        self.tolerance, self.reward_scale = tolerance, self.env.unwrapped.reward_scale
        plain = self.env.single_observation_space
        self.dof = self.action_space.shape[0]
        low, high = split(plain.low, self.dof), split(plain.high, self.dof)
        self.observation_space = spaces.Dict({name: spaces.Box(low[name], high[name]) for name in low})

    def _shown(self, observations: Any) -> Any:
        """Observations (..., 6 + dof) by name."""
        return split(observations, self.dof)

    def compute_reward(self, achieved: NDArray[np.floating[Any]], desired: NDArray[np.floating[Any]]) -> Any:
        """Scaled reward (n,) of a step that ends at positions `achieved` (n, 3), for targets `desired` (n, 3)."""
        reached = np.linalg.norm(achieved - desired, axis=1) <= self.tolerance
        return self.reward_scale * (STEP_REWARD + GOAL_REWARD * reached)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method once, for all worlds."""
        if method_name == "compute_reward":
            return [self.compute_reward(*args[:2])]
        return super().env_method(method_name, *args, indices=indices, **kwargs)


class GoalFeatures(BaseFeaturesExtractor):
    """A view's features of the task's observation, which is concatenated again from its parts."""

    def __init__(self, observation_space: spaces.Dict, view: View) -> None:
        size = spaces.flatdim(observation_space)
        plain = view.extractor(spaces.Box(-np.inf, np.inf, (size,)))
        super().__init__(observation_space, plain.features_dim)
        self.plain = plain

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (n, k) of observations by name."""
        return self.plain(torch.cat([observations[name] for name in PARTS], dim=1))


class HindsightBuffer(HerReplayBuffer):
    """A replay buffer in which relabelled successes end their episode, as successes do in the task.

    Stable-Baselines3's own would bootstrap beyond them.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.infos = np.empty(0)  # unused: a dict for each transition

    def _get_virtual_samples(self, *args: Any) -> DictReplayBufferSamples:
        samples = super()._get_virtual_samples(*args)
        reached = samples.rewards > self.env.reward_scale * STEP_REWARD
        return samples._replace(dones=reached.float())
