"""Potential-based shaping of rewards, as Gymnasium wrappers.

After Ng, Harada and Russell, "Policy invariance under reward transformations", ICML 1999:

    shaping(s, s') = gamma * potential(s') - potential(s)

where the potential of s' is taken as 0 if the episode terminated there, but not if it was truncated. Over an episode of
T steps, the discounted sum is gamma^T * potential(end) - potential(start).
"""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.envs import TaskEnv, TaskVectorEnv
from armctl.shaping.potentials import PotentialFactory, make_potential

TERM = "shaping"
"""Name of the reward term."""


def difference(gamma: float, previous: Array, current: Array, terminated: NDArray[np.bool_]) -> Array:
    """Return the shaping term (n,) of steps between states with potentials `previous` and `current` (n,)."""
    return np.asarray(gamma * np.where(terminated, 0.0, current) - previous)


class Shaped(gymnasium.vector.VectorWrapper[Any, Any, Any, Any, Any]):
    """Adds potential-based shaping to a vector environment's rewards, as the term `shaping` in `infos["reward_terms"]`.

    Args:
        env: vector environment of armctl, in any autoreset mode, before its first reset.
        potential: name of a potential (see `potential_names`), or a function from the vector environment to one.
        gamma: discount factor of the learner.
        scale: reward per unit of the potential, before the environment's `reward_scale`.

    Raises `ConfigurationError` for a potential that this environment does not have, and for values out of range.

    """

    def __init__(
        self,
        env: gymnasium.vector.VectorEnv[Any, Any, Any],
        potential: str | PotentialFactory,
        *,
        gamma: float,
        scale: float = 1.0,
    ) -> None:
        super().__init__(env)
        self._difference = _Difference(env.unwrapped, potential, gamma, scale)

    @property
    def autoreset_mode(self) -> AutoresetMode:
        """The environment's, for which learners ask; Gymnasium's wrappers do not hand such attributes on."""
        mode: AutoresetMode = self.env.metadata["autoreset_mode"]
        return mode

    def step(self, actions: ArrayLike) -> tuple[Any, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Make one control step in every world."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        shaping = self._difference.of(terminated)
        infos["reward_terms"][TERM] = shaping
        return observations, rewards + self._difference.reward_scale * shaping, terminated, truncated, infos

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Start new episodes."""
        observations, infos = self.env.reset(**arguments)
        infos["reward_terms"][TERM] = np.zeros(self.num_envs)
        return observations, infos


class ShapedEnv(gymnasium.Wrapper[Any, Any, Any, Any]):
    """The same for one environment: `ShapedEnv(gymnasium.make("armctl/ArmReach-v0"), "ik", gamma=0.99)`."""

    def __init__(
        self, env: gymnasium.Env[Any, Any], potential: str | PotentialFactory, *, gamma: float, scale: float = 1.0
    ) -> None:
        super().__init__(env)
        inner = env.unwrapped
        self._difference = _Difference(inner.worlds if isinstance(inner, TaskEnv) else inner, potential, gamma, scale)

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Make one control step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        shaping = float(self._difference.of(np.array([terminated]))[0])
        info["reward_terms"][TERM] = shaping
        return observation, float(reward) + self._difference.reward_scale * shaping, terminated, truncated, info

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observation, info = self.env.reset(**arguments)
        info["reward_terms"][TERM] = 0.0
        return observation, info


class _Difference:
    """Change of the potential in the last control step, observed before any autoreset."""

    def __init__(self, worlds: Any, potential: str | PotentialFactory, gamma: float, scale: float) -> None:
        if not isinstance(worlds, TaskVectorEnv):
            raise ConfigurationError(f"only armctl's own environments can be shaped; {worlds} is not one of them")
        if worlds.flat_infos:
            raise ConfigurationError("shaping adds to reward_terms, which flat_infos=True takes apart: leave that out")
        if any(isinstance(observer, _Difference) for observer in worlds.observers):
            raise ConfigurationError("this environment is shaped already")
        if not (isinstance(gamma, (int, float)) and 0 <= gamma <= 1):
            raise ConfigurationError(f"gamma is the learner's discount factor, from 0 to 1, not {gamma!r}")
        if not (isinstance(scale, (int, float)) and np.isfinite(scale)):
            raise ConfigurationError(f"scale is a finite number, not {scale!r}")
        self._potential, self._gamma, self._scale = make_potential(potential, worlds), gamma, scale
        self._latest, self._previous, self._current = np.full((3, worlds.num_envs), np.nan)
        self.reward_scale = worlds.reward_scale
        self._awake = np.zeros(worlds.num_envs, dtype=bool)
        worlds.observers.append(self)

    def began(self, ids: NDArray[np.int32]) -> None:
        self._potential.begin(ids)
        self._latest[ids] = self._scale * self._potential.potentials(ids)

    def stepped(self, awake: NDArray[np.bool_]) -> None:
        everywhere = np.arange(len(awake), dtype=np.int32)
        self._awake, self._previous = awake, self._latest
        self._current = self._scale * self._potential.potentials(everywhere)
        self._latest = self._current.copy()

    def of(self, terminated: NDArray[np.bool_]) -> Array:
        """Return the reward term (n,) of the last control step; 0 in worlds that were not stepped."""
        return np.where(self._awake, difference(self._gamma, self._previous, self._current, terminated), 0.0)
