"""armctl's vector environments as its own learners see them."""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from armctl.rl.actor import tensors
from armctl.sb3 import VecEnv


class StableBaselinesVectorEnv(VecEnv):
    """Actions in [-1, 1], which a view's `action_scale` turns into the environment's, and weighted, scaled rewards.

    The reward is the weighted sum of the reward terms (weight 1 for terms without one).
    """

    def __init__(
        self,
        env: gymnasium.vector.VectorEnv[Any, Any, Any],
        action_scale: torch.nn.Module,
        reward_scale: float = 1.0,
        reward_weights: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__(env)
        self.action_space = gymnasium.spaces.Box(-1, 1, env.single_action_space.shape)
        self.reward_scale = reward_scale
        self._action_scale, self._weights = action_scale, reward_weights or {}

    def _commands(self, actions: NDArray[Any]) -> Any:
        return self._action_scale(tensors(self._observations), torch.as_tensor(actions)).numpy()

    def _rewards(self, rewards: NDArray[Any], terms: dict[str, NDArray[Any]]) -> NDArray[Any]:
        weighted = sum(self._weights.get(name, 1.0) * earned for name, earned in terms.items())
        return self.reward_scale * np.asarray(weighted)
