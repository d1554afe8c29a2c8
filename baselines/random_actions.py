"""Uniform random actions: the lower bound for any policy."""

import copy
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from armctl.envs import EpisodeVectorEnv


class RandomActions:
    """Uniform random actions that depend only on seed and episode."""

    sees: Literal["observation", "state"] = "observation"
    training_steps = 0

    def __init__(self, env: EpisodeVectorEnv, seed: int = 0) -> None:
        self._env = env
        self._seed = seed
        space = env.single_action_space
        bounded = isinstance(space, spaces.Box) and space.is_bounded()
        self._samplers = [_Uniform(space) if bounded else _Sampler(space) for _ in range(env.num_envs)]

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Seed the generators of worlds `ids` by their new episodes."""
        for i in ids:
            self._samplers[i].seed((self._seed, int(self._env.seeds[i]), int(self._env.episodes[i])))

    def act(self, observations: Any) -> NDArray[Any]:
        """Actions (n, ...), independent of observations."""
        samples = [sampler.sample() for sampler in self._samplers]
        if not isinstance(samples[0], (dict, tuple)):
            return np.array(samples)
        actions = np.empty(len(samples), dtype=object)
        actions[:] = samples
        return actions


class _Uniform:
    """Samples a bounded box."""

    def __init__(self, space: Any) -> None:
        self._space = space
        self.seed((0,))

    def seed(self, entropy: tuple[int, ...]) -> None:
        self._rng = np.random.default_rng(entropy)

    def sample(self) -> NDArray[np.float64]:
        return np.asarray(self._rng.uniform(self._space.low, self._space.high))


class _Sampler:
    """Samples any other space, by the space's own method."""

    def __init__(self, space: Any) -> None:
        self._space = copy.deepcopy(space)

    def seed(self, entropy: tuple[int, ...]) -> None:
        self._space.seed(int(np.random.SeedSequence(entropy).generate_state(1)[0]))

    def sample(self) -> Any:
        return self._space.sample()
