"""The random-action runner of old: uniform over the action space. What any policy should beat."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armctl.envs import TaskVectorEnv


class RandomActions:
    """Uniform random actions, a function of seed and episode alone."""

    sees: Literal["observation", "state"] = "observation"
    training_steps = 0

    def __init__(self, env: TaskVectorEnv, seed: int = 0) -> None:
        self._env = env
        self._space = env.single_action_space
        self._seed = seed
        self._rngs = [np.random.default_rng(seed)] * env.num_envs

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Draw anew, by the episode that begins."""
        for i in ids:
            self._rngs[i] = np.random.default_rng((self._seed, self._env.seeds[i], self._env.episodes[i]))

    def act(self, observations: NDArray[np.float32]) -> NDArray[np.float64]:
        """Actions (n, ...), whatever is observed."""
        return np.array([rng.uniform(self._space.low, self._space.high) for rng in self._rngs])
