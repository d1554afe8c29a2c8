"""Hindsight experience replay (Andrychowicz et al. 2017) for the reach task, by Stable-Baselines3's buffer.

An episode that missed its target has reached other positions: with one of them as the target, it is a success.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import DictReplayBufferSamples

from armctl.rl.networks.frames import FrameFeatures
from armctl.rl.networks.view import View
from armctl.rl.run.vector import EncodedVectorEnv
from armctl.tasks.reach import observation_sizes
from armctl.tasks.reach.state import GOAL_REWARD, STEP_REWARD

POSITION = observation_sizes(dof=0)["target_position"]
"""Count of numbers of a position: the task's observation begins with the end-effector's, and ends with the target's."""


def split(stacks: Any) -> dict[str, Any]:
    """Return stacks of observations (..., frames, 6 + dof), arrays or tensors, as a goal-conditioned environment's.

    What is left of them without the target is `observation` (..., frames, 3 + dof).
    """
    without_goal = stacks[..., :-POSITION]
    return {
        "achieved_goal": without_goal[..., -1, :POSITION],
        "desired_goal": stacks[..., -1, -POSITION:],
        "observation": without_goal,
    }


def joined(observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
    """Return stacks (n, frames, 6 + dof) in which each frame has the goal that is desired: the inverse of `split`."""
    without_goal, goal = observations["observation"], observations["desired_goal"]
    return torch.cat((without_goal, goal[:, None].expand(-1, without_goal.shape[1], -1)), dim=2)


class GoalVectorEnv(EncodedVectorEnv):
    """Reach worlds with `achieved_goal`, the end-effector's position, and `desired_goal`, the target's (m)."""

    takes_features = False  # hindsight changes the goals of what it has stored

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        worlds = self.env.unwrapped
        self.tolerance, self.reward_scale = worlds.task.options.tolerance, worlds.reward_scale
        low, high = split(self.encoder.space.low), split(self.encoder.space.high)
        self.observation_space = spaces.Dict({name: spaces.Box(low[name], high[name]) for name in low})

    def reset(self) -> Any:
        """Start new episodes in all worlds."""
        return split(super().reset())

    def step_wait(self) -> Any:
        """Step all worlds."""
        observations, rewards, done, infos = super().step_wait()
        for i in np.flatnonzero(done):
            infos[i]["terminal_observation"] = split(infos[i]["terminal_observation"])
        return split(observations), rewards, done, infos

    @property
    def policy_kwargs(self) -> dict[str, Any]:
        """Arguments of a policy for the features of observations and goals."""
        return {"features_extractor_class": GoalFeatures, "features_extractor_kwargs": {"view": self.view}}

    def compute_reward(self, achieved: NDArray[np.floating[Any]], desired: NDArray[np.floating[Any]]) -> Any:
        """Return the scaled reward (n,) of steps that end at `achieved` (n, 3), for targets `desired` (n, 3)."""
        reached = np.linalg.norm(achieved - desired, axis=1) <= self.tolerance
        return self.reward_scale * (STEP_REWARD + GOAL_REWARD * reached)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method once, for all worlds."""
        if method_name == "compute_reward":
            return [self.compute_reward(*args[:2])]
        return super().env_method(method_name, *args, indices=indices, **kwargs)


class GoalFeatures(BaseFeaturesExtractor):
    """A view's features of the stacks of which goals were split."""

    def __init__(self, observation_space: spaces.Dict, view: View) -> None:
        frames, size = observation_space["observation"].shape  # type: ignore[misc]
        features = FrameFeatures(spaces.Box(-np.inf, np.inf, (frames, size + POSITION)), view)
        super().__init__(observation_space, features.features_dim)
        self.features = features

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features (n, k) of observations by name."""
        return self.features(joined(observations))


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
