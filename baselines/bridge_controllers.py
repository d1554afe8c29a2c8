"""Common part of the bridge experts: a policy with one controller per world, which sees the map and the true state."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armctl.control.arc_path import ArcPath
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.envs import Sees, TaskVectorEnv
from armctl.planning import plan_path
from armctl.scene import BridgeMap
from armctl.tasks import BridgeTask

SHOWN_HEIGHT = 0.05
"""m: height above the deck at which plans are drawn."""


class BridgeController(Protocol):
    """Crosses one bridge."""

    def act(self, pose: Array, velocity: Array, time: float) -> tuple[float, float]:
        """Return linear (m/s) and angular velocity (rad/s) for a pose (x, y, yaw), current velocities, and time (s)."""

    def see(self, bridge: BridgeMap) -> None:
        """Go by this map from now on: it is where things are believed to be, and noise may move them."""

    def plans(self) -> dict[str, Array]:
        """Return planned paths by name: lines of points (m, 2) m."""


class PathFollower(Protocol):
    """A follower of one path."""

    path: ArcPath
    progress: float


def path_from(bridge: BridgeMap, position: Array, goal_x: float) -> Array:
    """Return corners (m, 2) m of a path to the goal line; (0, 2) if there is none, as off the free deck."""
    on_deck = bridge.clearance(position[None])[0] > 0 and position[0] < goal_x
    return plan_path(bridge, position, goal_x).path if on_deck else np.zeros((0, 2))


def distance_from_path(follower: PathFollower, pose: Array) -> float:
    """Return the distance (m) of a pose from the point of the path that a follower has reached."""
    return float(np.linalg.norm(follower.path.points_at(follower.progress) - pose[:2]))


class BridgePolicy:
    """A policy of controllers, each made for a map and the goal line's x (m)."""

    sees: Sees = "state"
    training_steps = 0

    def __init__(self, name: str, env: TaskVectorEnv, make_one: Callable[[BridgeMap, float], BridgeController]) -> None:
        if not isinstance(env.task, BridgeTask):
            raise ConfigurationError(f"{name} cannot play this task: use it with armctl/BridgeCross-v0")
        self._env, self._make_one = env, make_one
        self._controllers: list[BridgeController | None] = [None] * env.num_envs
        self._failed_before = np.zeros(env.num_envs, dtype=np.int64)

    @property
    def failures(self) -> NDArray[np.int64]:
        """(n,) number of solver failures in each world; 0 for controllers that do not count them."""
        counts = [getattr(controller, "failures", 0) for controller in self._controllers]
        return np.add(self._failed_before, counts, dtype=np.int64)

    def plans(self, world: int) -> dict[str, Array]:
        """Return the plans of a world's controller: lines of points (m, 3) m, just above the deck."""
        controller = self._controllers[world]
        lines = controller.plans() if controller else {}
        return {name: np.column_stack((points, np.full(len(points), SHOWN_HEIGHT))) for name, points in lines.items()}

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Make new controllers for worlds `ids`, which have new maps."""
        for i in ids:
            self._failed_before[i] += getattr(self._controllers[i], "failures", 0)
            self._controllers[i] = self._make_one(self._env.perceived().map(i), self._env.task.goal_x)

    def act(self, observations: Any) -> Array:
        """Return linear and angular velocities (n, 2), m/s and rad/s."""
        perceived = self._env.perceived()
        if perceived is not self._env.task:
            for i, controller in enumerate(self._controllers):
                if controller:
                    controller.see(perceived.map(i))
        state = perceived.state
        states = zip(self._controllers, state.poses, state.velocities, state.time, strict=True)
        return np.array([controller.act(*values) if controller else (0.0, 0.0) for controller, *values in states])
