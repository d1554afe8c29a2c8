"""Uniform random actions: the lower bound for any policy."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armctl.envs import TaskVectorEnv


class RandomActions:
    """Uniform random actions that depend only on seed and episode."""

    sees: Literal["observation", "state"] = "observation"
    training_steps = 0

    def __init__(self, env: TaskVectorEnv, seed: int = 0) -> None:
        self._env = env
        self._space = env.single_action_space
        self._seed = seed
        self._rngs = [np.random.default_rng(seed)] * env.num_envs

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Seed the generators of worlds `ids` by their new episodes."""
        for i in ids:
            self._rngs[i] = np.random.default_rng((self._seed, self._env.seeds[i], self._env.episodes[i]))

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """Actions (n, ...), independent of observations."""
        return np.array([rng.uniform(self._space.low, self._space.high) for rng in self._rngs])
