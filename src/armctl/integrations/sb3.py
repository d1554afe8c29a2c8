"""Any vector environment of armctl's for Stable-Baselines3, which the extra `rl` installs.

worlds = gymnasium.make_vec("armctl:armctl/ArmReach-v0", num_envs=16, autoreset_mode="same_step")
model = stable_baselines3.PPO("MlpPolicy", armctl.integrations.sb3.VecEnv(worlds))
"""

import time
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common import vec_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from armctl.core.errors import ConfigurationError
from armctl.envs import EpisodeVectorEnv, one_of
from armctl.tasks.reach.observation import LENGTH_SCALE, NEARBY

SHAPING = "shaping"
"""The reward term that is the learner's, and not the task's."""


class VecEnv(vec_env.VecEnv):  # type: ignore[misc]
    """Worlds that are stepped at once, as Stable-Baselines3 wants them.

    `infos` describe episodes that have just ended, as `Monitor` would: `terminal_observation`, `TimeLimit.truncated`,
    `is_success`, and `episode` with its return `r` (the task's: without shaping and `reward_scale`), length `l` and the
    seconds `t` since this was made.

    `env` is a vector environment of armctl's, shaped or not, with `autoreset_mode="same_step"`. Raises
    `ConfigurationError` for any other.
    """

    def __init__(self, env: gymnasium.vector.VectorEnv[Any, Any, Any]) -> None:
        if not isinstance(env.unwrapped, EpisodeVectorEnv):
            raise ConfigurationError(f"VecEnv takes what gymnasium.make_vec makes of an armctl environment, not {env}")
        if env.metadata["autoreset_mode"] is not AutoresetMode.SAME_STEP:
            raise ConfigurationError("Stable-Baselines3 needs autoreset_mode='same_step'")
        if getattr(env.unwrapped, "flat_infos", False):
            raise ConfigurationError("VecEnv reads reward_terms, which flat_infos=True takes apart")
        self.env: Any = env
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._returns, self._lengths = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=np.int64)
        self._began = time.monotonic()

    def reset(self) -> Any:
        """Start new episodes in all worlds, with the seeds and options of `seed` and `set_options`, if called since."""
        seeds = [seed for seed in self._seeds if seed is not None]
        self._observations, _ = self.env.reset(seed=seeds or None, options=self._options[0] or None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return self._observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions (n, ...) for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step all worlds."""
        commands = self._commands(self._actions)
        self._observations, rewards, terminated, truncated, infos = self.env.step(commands)
        terms, done = infos["reward_terms"], terminated | truncated
        self._returns += sum(term_rewards for name, term_rewards in terms.items() if name != SHAPING)
        self._lengths += 1
        world_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        seconds = round(time.monotonic() - self._began, 6)
        for i in np.flatnonzero(done):
            world_infos[i] = {
                "terminal_observation": one_of(infos["final_obs"], int(i)),
                "TimeLimit.truncated": bool(truncated[i]),
                "is_success": bool(infos["final_info"]["is_success"][i]),
                "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i]), "t": seconds},
            }
        self._returns[done] = 0.0
        self._lengths[done] = 0
        return self._observations, np.asarray(rewards, dtype=np.float32), done, world_infos

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    def get_images(self) -> Sequence[Any]:
        """Images (height, width, 3) of all worlds."""
        return self.env.render() or ()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return the environment's attribute, the same for all worlds."""
        return [self._attribute(attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of the environment, for all worlds."""
        setattr(self.env.unwrapped, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of the environment once, for all worlds."""
        return [self._attribute(method_name)(*args, **kwargs)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return whether the worlds do what a wrapper does: that of `Monitor`, and no other's."""
        return [wrapper_class is Monitor] * len(list(self._get_indices(indices)))

    def _attribute(self, name: str) -> Any:
        return getattr(self.env if hasattr(self.env, name) else self.env.unwrapped, name)

    def _commands(self, actions: NDArray[Any]) -> Any:
        """Return the environment's actions."""
        return actions


class GoalFeatures(BaseFeaturesExtractor):  # type: ignore[misc]
    """The reach task's features where `goal=True` keeps the goal apart, and joint velocities.

    Hindsight changes the goal of what was observed, so here the network has to relate the arm to it. For arms whose
    first joint is vertical, as those of armctl. To be given as `policy_kwargs={"features_extractor_class": ...}`.

    Raises `ConfigurationError` for other observations than those of `observation="features"` with `goal=True`.
    """

    def __init__(self, observation_space: gymnasium.Space[Any]) -> None:
        parts = observation_space.spaces if isinstance(observation_space, gymnasium.spaces.Dict) else {}
        highest = getattr(parts.get("observation"), "high", np.zeros(0))
        self.dof = (len(highest) - 3) // 3
        if "desired_goal" not in parts or (highest[3 : 3 + 2 * self.dof] != 1).any():
            raise ConfigurationError("GoalFeatures takes observations of goal=True, observation='features'")
        super().__init__(observation_space, 13 + 2 * (self.dof - 1) + self.dof)

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (n, 11 + 3 dof) of observations by name."""
        _, sines, cosines, velocities = observations["observation"].split([3, *[self.dof] * 3], dim=1)
        sine, cosine = sines[:, :1], cosines[:, :1]

        def ahead(positions: torch.Tensor) -> torch.Tensor:
            x, y, z = positions.split(1, dim=1)
            return torch.cat((cosine * x + sine * y, cosine * y - sine * x, z), dim=1)

        tip, target = ahead(observations["achieved_goal"]), ahead(observations["desired_goal"])
        offset = target - tip
        distance = offset.norm(dim=1, keepdim=True)
        lengths = LENGTH_SCALE * torch.cat((tip, target, offset, distance), dim=1)
        posture = (sines[:, 1:], cosines[:, 1:], velocities)
        return torch.cat((lengths, offset / (distance + NEARBY), *posture), dim=1)
