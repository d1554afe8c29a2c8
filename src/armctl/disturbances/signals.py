"""Disturbances of sensors and commands, and external pushes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.disturbances.disturbance import Array, Disturbable, Disturbance, Observations

PUSH_INTERVAL = 1.0
"""s between two pushes, on average."""


class Noise(Disturbance):
    """Adds white Gaussian noise of standard deviation `level` to every observed number, in the number's own unit.

    Numbers that are exactly 0 stand for absent objects, and are left as they are; so are integer images. The result is
    clipped to the observation space.
    """

    per_episode = True

    def __init__(self, task: Disturbable, level: float) -> None:
        super().__init__(task, level)
        seen = task.observe()
        arrays = seen if isinstance(seen, dict) else {"": seen}
        numbers = {name: values for name, values in arrays.items() if values.dtype.kind == "f"}
        self._noise = {name: np.zeros(values.shape, dtype=np.float32) for name, values in numbers.items()}

    def begin(self, ids: NDArray[np.int32]) -> None:
        """Sample the noise of the first observation."""
        for noise in self._noise.values():
            for i in ids:
                self.rngs[i].standard_normal(out=noise[i], dtype=np.float32)

    def command(self, actions: Array) -> Array:
        """Sample the noise of the next observation."""
        self.begin(self.worlds)
        return actions

    def observe(self, observations: Observations, ids: NDArray[np.int32] | slice) -> Observations:
        """Observations with noise."""
        space: Any = self.task.observation_space
        if isinstance(observations, dict):
            return {name: self._noisy(values, name, space[name], ids) for name, values in observations.items()}
        return self._noisy(observations, "", space, ids)

    def _noisy(self, values: NDArray[Any], name: str, space: Any, ids: NDArray[np.int32] | slice) -> NDArray[Any]:
        if name not in self._noise:
            return values
        noise = self._noise[name][ids]
        noise = self.levels[ids].astype(np.float32).reshape(-1, *[1] * (noise.ndim - 1)) * noise
        return np.where(values == 0, values, np.clip(values + noise, space.low, space.high))


class Dropout(Disturbance):
    """Replaces camera images by black ones (all 0), each with probability `level`."""

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
        """Observations with lost images black."""
        assert isinstance(observations, dict)
        lost = self._lost[ids][:, *[None] * (observations["image"].ndim - 1)]
        return observations | {"image": np.where(lost, np.zeros_like(observations["image"]), observations["image"])}


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
        """The actions of `levels` control steps ago."""
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
