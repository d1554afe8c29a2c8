"""Disturbances of sensors and commands, and external pushes."""

import copy
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array, Observations
from armctl.disturbances.disturbance import Channel, Disturbable, Disturbance

PUSH_INTERVAL = 1.0
"""s between two pushes, on average."""
IMAGES = ("image", "ranges")
"""Parts of observations that are a camera's image, or what is left of it."""


class Noise(Disturbance):
    """Adds white Gaussian noise of standard deviation `level` to every observed number, in the number's own unit.

    Numbers that are exactly 0 stand for absent objects, and are left as they are. The result is clipped to the
    observation space. It applies only where all observed arrays are of floating-point numbers.
    """

    per_episode = True

    def __init__(self, task: Disturbable, level: float) -> None:
        super().__init__(task, level)
        observation = task.observe()
        arrays = observation if isinstance(observation, dict) else {"": observation}
        self._noise = {name: np.zeros(values.shape, dtype=np.float32) for name, values in arrays.items()}

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Sample the noise of the first observation."""
        self._sample(ids)

    def command(self, actions: Array) -> Array:
        """Sample the noise of the next observation."""
        self._sample(self.worlds)
        return actions

    def _sample(self, ids: NDArray[np.int32]) -> None:
        for noise in self._noise.values():
            for i in ids:
                self.rngs[i].standard_normal(out=noise[i], dtype=np.float32)

    def observe(self, observations: Observations, ids: NDArray[np.int32] | slice) -> Observations:
        """Return observations with noise."""
        space: Any = self.task.observation_space
        if isinstance(observations, dict):
            return {
                name: self._noisy(values, self._noise[name], space[name], ids) for name, values in observations.items()
            }
        return self._noisy(observations, self._noise[""], space, ids)

    def _noisy(
        self, values: NDArray[Any], noise: NDArray[np.float32], space: Any, ids: NDArray[np.int32] | slice
    ) -> NDArray[Any]:
        noise = noise[ids]
        noise = self.levels[ids].astype(np.float32).reshape(-1, *[1] * (noise.ndim - 1)) * noise
        return np.where(values == 0, values, np.clip(values + noise, space.low, space.high))


class StateNoise(Noise):
    """Noise on the observation, and on the state that policies read instead (`EpisodeVectorEnv.perceived`).

    Who observes the state's numbers and who reads them get the same ones in the same episode, by generators alike.
    """

    channels: ClassVar[frozenset[Channel]] = frozenset({"observation", "state"})

    def __init__(self, task: Any, level: float) -> None:
        super().__init__(task, level)
        self._state_noise = np.zeros(task.state_observation().shape, dtype=np.float32)
        self._state_rngs = list(self.rngs)

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Sample the noise of the first observation and state."""
        for i in ids:
            self._state_rngs[i] = copy.deepcopy(self.rngs[i])
        super().begin(ids)

    def _sample(self, ids: NDArray[np.int32]) -> None:
        super()._sample(ids)
        for i in ids:
            self._state_rngs[i].standard_normal(out=self._state_noise[i], dtype=np.float32)

    def perceive(self, numbers: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the state's numbers with noise."""
        task: Any = self.task
        return self._noisy(numbers, self._state_noise, task.state_space, slice(None))


class Dropout(Disturbance):
    """Replaces camera images, or ranges in their place, by black ones (all 0), each with probability `level`."""

    per_episode = True

    def __init__(self, task: Disturbable, level: float) -> None:
        super().__init__(task, level)
        self._lost = np.zeros(task.n, dtype=bool)

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Sample whether the first image is lost."""
        for i in ids:
            self._lost[i] = self.rngs[i].random() < self.levels[i]

    def command(self, actions: Array) -> Array:
        """Sample whether the next image is lost."""
        self.begin(self.worlds)
        return actions

    def observe(self, observations: Observations, ids: NDArray[np.int32] | slice) -> Observations:
        """Return observations with lost images black."""
        assert isinstance(observations, dict)
        lost = self._lost[ids]
        images = {name: values for name, values in observations.items() if name in IMAGES}
        return observations | {
            name: np.where(lost.reshape(-1, *[1] * (values.ndim - 1)), np.zeros_like(values), values)
            for name, values in images.items()
        }


class Delay(Disturbance):
    """Delays actions by `level` control steps. Until the first one arrives, the robot gets the idle action."""

    per_episode = True

    def __init__(self, task: Disturbable, level: float) -> None:
        super().__init__(task, level)
        self._idle = np.array(task.idle_action)
        self._waiting = np.zeros((task.n, int(level), *task.action_space.shape))

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Fill the delay line with idle actions."""
        self._waiting[ids] = self._idle

    def command(self, actions: Array) -> Array:
        """Return the actions of `levels` control steps ago."""
        line = np.concatenate((self._waiting, actions[:, None]), axis=1)
        self._waiting = line[:, 1:]
        return np.asarray(line[self.worlds, int(self.level) - self.levels.astype(int)])


class Pushes(Disturbance):
    """Pushes the task's `payload_body` with an impulse of `level` N s, about once per `PUSH_INTERVAL`.

    A push lasts one control step. Its direction is random, and horizontal if `horizontal`.
    """

    per_episode = True

    def __init__(self, task: Disturbable, level: float, horizontal: bool = False) -> None:
        super().__init__(task, level)
        simulation = task.simulation
        self._period = task.control_period
        self._forces = simulation.array("xfrc_applied")[:, simulation.model.body(task.payload_body).id, :3]
        self._axes = 2 if horizontal else 3

    def command(self, actions: Array) -> Array:
        """Sample this step's pushes, and apply them."""
        directions = np.array([rng.standard_normal(self._axes) for rng in self.rngs])
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        pushed = np.array([[rng.random()] for rng in self.rngs]) < self._period / PUSH_INTERVAL
        forces = self.levels[:, None] / self._period
        self._forces[:, : self._axes] = np.where(pushed, forces * directions, 0.0)
        return actions
