"""Forecasts of a moving target by a trained network, in place of the constant acceleration that an observer believes.

A network reads the last readings of an axis, position and velocity, and returns where the target will be in the next
second, and how fast. It has learned from curves like the task's, with noise of many sizes (`tools/train_forecasts.py`),
and never from an arm. `ForecastingObserver` is `armctl.estimation.arm_observer` with these forecasts: a controller that
plans by it becomes a hybrid.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from armctl.agents.agent import sha256
from armctl.agents.costs import TrainingCost, TuningCost
from armctl.agents.graph import load_graph
from armctl.core.arrays import Array
from armctl.core.errors import AgentFileError
from armctl.estimation.arm_observer import ArmObserver
from armctl.kinematics import ArmModel

FOLDER = Path(__file__).with_name("forecasts")
SEEDS = (0, 1, 2)
"""Training seeds of the networks in the folder."""
WINDOW = 128
"""Control steps of which the network reads: 5.1 s."""
KNOTS = np.linspace(0.0, 1.0, 6)
"""s from the last reading, at which the network returns positions and velocities; cubic in between."""
POSITION, VELOCITY, READ = range(3)
"""Channels of an axis: m from the window's mean, m/s, and 1 where there was a reading."""


TUNING = TuningCost(trials=1, minutes=0.7)
"""Trial with half of the window, as `rl/trials.csv` has it."""


class TargetForecast:
    """Network of one training seed. Raises `AgentFileError` for a file that is damaged or missing."""

    def __init__(self, seed: int) -> None:
        graph = FOLDER / f"target-{seed}.onnx"
        card = json.loads(graph.with_suffix(".json").read_text())
        if sha256(graph) != card["sha256"]:
            raise AgentFileError(f"{graph} does not have the checksum on its card: it was changed, or damaged")
        self.cost = TrainingCost(**card["cost"], tuning=TUNING)
        """Cost of the training."""
        self._graph = load_graph(graph)

    def __call__(self, windows: Array) -> Array:
        """Return positions (m from the means) and velocities (m/s) at the knots, (n, 2, 6), for windows (n, 3, 128)."""
        return np.asarray(self._graph.run({"observation": windows.astype(np.float32)})[0], dtype=float)


class ForecastingObserver(ArmObserver):
    """Estimates for one arm, whose moving target is filtered and foreseen by a network."""

    def __init__(self, forecast: TargetForecast, model: ArmModel, period: float, clock: Callable[[], int]) -> None:
        self._forecast = forecast
        super().__init__(model, period, moving=True, clock=clock)

    def reset(self) -> None:
        """Forget everything, for a new episode."""
        super().reset()
        self._window = np.zeros((3, 3, WINDOW))
        self._positions, self._velocities = np.zeros((2, 3, len(KNOTS)))

    def read(self, tip: Array, q: Array, target: Array, target_velocity: Array | None = None) -> None:
        """Take the readings of a control step, as `ArmObserver.read` does, with the target's velocity."""
        assert target_velocity is not None
        previous = self._last_step
        super().read(tip, q, target, target_velocity)
        self._window = np.concatenate((self._window, np.zeros((3, 3, self._last_step - previous))), axis=2)
        self._window = self._window[:, :, -WINDOW:]
        self._window[:, :, -1] = np.column_stack((target, target_velocity, np.ones(3)))
        self._foresee()

    def _foresee(self) -> None:
        """Ask the network, with positions relative to their mean."""
        has_read = self._window[:, READ]
        mean = (self._window[:, POSITION] * has_read).sum(axis=1, keepdims=True) / has_read.sum(axis=1, keepdims=True)
        windows = self._window.copy()
        windows[:, POSITION] -= mean * has_read
        positions, self._velocities = self._forecast(windows).swapaxes(0, 1)
        self._positions = positions + mean

    @property
    def target(self) -> Array:
        """Target (3,) m now."""
        return self._positions[:, 0]

    def target_ahead(self, times: ArrayLike) -> Array:
        """Return the target (..., 3) m at times (...) s from the moment on from which the next command acts."""
        return self._between_knots(np.asarray(times) + self.delay * self._period)[0]

    def target_velocity_ahead(self) -> Array:
        """Return the velocity (3,) m/s of the target at the moment from which the next command acts."""
        return self._between_knots(np.asarray(self.delay * self._period))[1]

    def _between_knots(self, times: Array) -> tuple[Array, Array]:
        """Return positions and velocities (..., 3) at times (...) s from now: cubic Hermite splines."""
        step = KNOTS[1]
        first = np.clip(times // step, 0, len(KNOTS) - 2).astype(int)
        t = np.clip(times / step - first, 0.0, 1.0)[..., None]
        (p, q), (u, v) = (
            (values.T[first], values.T[first + 1]) for values in (self._positions, step * self._velocities)
        )
        a, b = 2 * (p - q) + u + v, 3 * (q - p) - 2 * u - v
        return p + t * (u + t * (b + t * a)), (u + t * (2 * b + 3 * t * a)) / step
