"""Adapter from armctl's batched environments to the vector environments of Stable-Baselines3."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from armctl.envs import one_of
from armctl.rl.actor import tensors

Array = NDArray[np.float64]


class StableBaselinesVectorEnv(VecEnv):
    """A vector environment with same-step autoreset, for Stable-Baselines3: actions in [-1, 1], scaled rewards.

    The reward is the weighted sum of the reward terms (weight 1 for terms without one). `infos` describe episodes that
    have just ended: `terminal_observation`, `TimeLimit.truncated`, `is_success`, and `episode` (its length, and its
    return without weights or shaping).
    """

    def __init__(
        self,
        env: gymnasium.vector.VectorEnv[Any, Any, Any],
        action_scale: torch.nn.Module,
        reward_scale: float = 1.0,
        reward_weights: Mapping[str, float] | None = None,
    ) -> None:
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise ValueError("Stable-Baselines3 needs autoreset_mode='same_step'")
        self.env = env
        self._seed: int | None = None
        self.reward_scale = reward_scale
        self._action_scale = action_scale
        self._weights = reward_weights or {}
        actions = gymnasium.spaces.Box(-1, 1, env.single_action_space.shape)
        super().__init__(env.num_envs, env.single_observation_space, actions)
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, dtype=np.int64)

    def reset(self) -> Any:
        """Start new episodes in all worlds, with the seed given to `seed` if it was called since the last reset."""
        observations, _ = self.env.reset(seed=self._seed)
        self._seed = None
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self._observations = observations
        return self.shown(observations)

    def shown(self, observations: Any) -> Any:
        """Observations as the learner gets them, of all worlds or of one."""
        return observations

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed of the next `reset`."""
        self._seed = seed
        return [None if seed is None else seed + i for i in range(self.num_envs)]

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Store the actions (n, ...) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step all worlds."""
        actions = self._action_scale(tensors(self._observations), torch.as_tensor(self._actions))
        observations, _, terminated, truncated, infos = self.env.step(actions.numpy())
        terms = infos["reward_terms"]
        rewards = sum(self._weights.get(name, 1.0) * earned for name, earned in terms.items())
        self._observations = observations
        done = terminated | truncated
        self._returns += sum(earned for name, earned in terms.items() if name != "shaping")
        self._lengths += 1
        world_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            world_infos[i] = {
                "terminal_observation": self.shown(one_of(infos["final_obs"], int(i))),
                "TimeLimit.truncated": bool(truncated[i]),
                "is_success": bool(infos["final_info"]["is_success"][i]),
                "episode": {"r": self._returns[i], "l": int(self._lengths[i])},
            }
        self._returns[done] = 0.0
        self._lengths[done] = 0
        return self.shown(observations), self.reward_scale * rewards, done, world_infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The environment's attribute, the same for all worlds."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environment, for all worlds."""
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of the environment once, for all worlds."""
        return [getattr(self.env, method_name)(*args, **kwargs)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Always False: the worlds have no wrappers of their own."""
        return [False] * len(list(self._get_indices(indices)))
