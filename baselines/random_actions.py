"""Uniform random actions: the lower bound for any policy."""

import copy
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from armctl.core.arrays import object_array
from armctl.envs import Interface, Sees


class RandomActions:
    """Uniform random actions, determined by the run's policy seed and the episode."""

    sees: Sees = "observation"
    reads = ()
    training_steps = 0

    def __init__(self, env: Interface) -> None:
        space = env.single_action_space
        bounded = isinstance(space, spaces.Box) and space.is_bounded()
        kind = _Uniform if bounded else _Sampler
        self._samplers = [kind(space, env.rng(i)) for i in range(env.num_envs)]

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`; armctl has seeded their generators."""
        for i in ids:
            self._samplers[i].reset()

    def act(self, observations: Any) -> NDArray[Any]:
        """Return actions (n, ...), independent of observations."""
        samples = [sampler.sample() for sampler in self._samplers]
        return object_array(samples) if isinstance(samples[0], (dict, tuple)) else np.array(samples)


class _Uniform:
    """Samples a bounded box."""

    def __init__(self, space: Any, rng: np.random.Generator) -> None:
        self._space, self._rng = space, rng

    def reset(self) -> None:
        """Do nothing: the generator is all state, and armctl seeds it."""

    def sample(self) -> NDArray[np.float64]:
        return np.asarray(self._rng.uniform(self._space.low, self._space.high))


class _Sampler:
    """Samples any other space, by the space's own method."""

    def __init__(self, space: Any, rng: np.random.Generator) -> None:
        self._space, self._rng = copy.deepcopy(space), rng

    def reset(self) -> None:
        self._space.seed(int(self._rng.integers(2**32)))

    def sample(self) -> Any:
        return self._space.sample()
