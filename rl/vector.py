"""armctl's vector environments as its own learners see them."""

from typing import Any

import gymnasium
import torch
from numpy.typing import NDArray

from armctl.integrations.sb3 import VecEnv
from armctl.rl.actor import tensors


class StableBaselinesVectorEnv(VecEnv):
    """Actions in [-1, 1], which a view's `action_scale` turns into the environment's."""

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any], action_scale: torch.nn.Module) -> None:
        super().__init__(env)
        self.action_space = gymnasium.spaces.Box(-1, 1, env.single_action_space.shape)
        self._action_scale = action_scale

    def _commands(self, actions: NDArray[Any]) -> Any:
        return self._action_scale(tensors(self._observations), torch.as_tensor(actions)).numpy()
