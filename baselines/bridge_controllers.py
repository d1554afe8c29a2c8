"""What the bridge experts share: a driver for each world, who sees the map and the true state, and makes it cross."""

from collections.abc import Callable
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from armctl.envs import TaskVectorEnv
from armctl.errors import ConfigurationError
from armctl.planning import plan_path
from armctl.scene import BridgeMap
from armctl.tasks import BridgeTask

Array = NDArray[np.float64]

SHOWN_HEIGHT = 0.05
"""m above the deck, where plans are drawn."""


class BridgeController(Protocol):
    """Crosses one bridge."""

    def act(self, pose: Array, velocity: Array, time: float) -> tuple[float, float]:
        """Linear (m/s) and angular velocity (rad/s) for a pose (x, y, yaw), velocities now, and time (s)."""

    def plans(self) -> dict[str, Array]:
        """Where it means to drive: lines of points (m, 2), m."""


def path_from(bridge: BridgeMap, place: Array, goal_x: float) -> Array:
    """Corners (m, 2) of a way to the goal line; (0, 2) without one, as where a student has left the free deck."""
    on_deck = bridge.clearance(place[None])[0] > 0 and place[0] < goal_x
    return plan_path(bridge, place, goal_x).path if on_deck else np.zeros((0, 2))


class BridgePolicy:
    """A policy of drivers, each of whom is made for a map and the goal line's x, m."""

    sees: Literal["observation", "state"] = "state"
    training_steps = 0

    def __init__(self, name: str, env: TaskVectorEnv, driver: Callable[[BridgeMap, float], BridgeController]) -> None:
        if not isinstance(env.task, BridgeTask):
            raise ConfigurationError(f"{name} crosses bridges: use it with armctl/BridgeCross-v0")
        self._task, self._driver = env.task, driver
        self._drivers: list[BridgeController | None] = [None] * env.num_envs
        self._failed_before = np.zeros(env.num_envs, dtype=np.int64)

    @property
    def failures(self) -> NDArray[np.int64]:
        """(n,) how often the drivers' solvers have failed in each world; 0 for those that count nothing."""
        now = [getattr(driver, "failures", 0) for driver in self._drivers]
        return np.add(self._failed_before, now, dtype=np.int64)

    def plans(self, world: int) -> dict[str, Array]:
        """Where the world's driver means to drive: lines of points (m, 3), m, just above the deck."""
        driver = self._drivers[world]
        lines = driver.plans() if driver else {}
        return {name: np.column_stack((points, np.full(len(points), SHOWN_HEIGHT))) for name, points in lines.items()}

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Worlds `ids` have new maps."""
        for i in ids:
            self._failed_before[i] += getattr(self._drivers[i], "failures", 0)
            self._drivers[i] = self._driver(self._task.map(i), self._task.goal_x)

    def act(self, observations: Any) -> Array:
        """Linear and angular velocities (n, 2), m/s and rad/s."""
        state = self._task.state
        told = zip(self._drivers, state.poses, state.velocities, state.time, strict=True)
        return np.array([driver.act(*seen) if driver else (0.0, 0.0) for driver, *seen in told])
