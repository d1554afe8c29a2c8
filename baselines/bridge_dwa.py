"""A floor on the bridge: the dynamic window approach on what the depth camera sees.

Fox, Burgard, Thrun, "The dynamic window approach to collision avoidance", IEEE Robotics & Automation Magazine 4(1),
1997. Of the velocities within reach of the next control step, it takes the one whose arc gets farthest, among those
from which the rover could stop before an obstacle. Progress is measured along the shortest paths around the obstacles
seen so far (Brock, Khatib, "High-speed navigation using the global dynamic window approach", ICRA 1999), as in the BARN
challenge's baseline. People are obstacles that stand still. The pose is reckoned from wheels and gyro.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.bridge_view import BridgeView
from armctl.control.dynamic_window import arcs, dynamic_window
from armctl.core.arrays import Array
from armctl.core.options import Count, NonNegative, Positive, changed_options, options
from armctl.envs import ModelInterface
from armctl.kernels import cost_to_go as kernel
from armctl.planning import Lattice
from armctl.policies import PerWorld, made_for, sees
from armctl.robots.rover import RADIUS
from armctl.scene import BridgeMap
from armctl.tasks.bridge import CONTROL_PERIOD

STUCK = 0.1
"""m/s and rad/s: if the best velocity is less, it turns, and forgets what is out of view, as ROS's recovery does."""
DRIFT = 0.4
"""m by which the reckoned pose may be beside the true one: paths may lead so far beyond the barriers."""

FAR = 1.0
"""m: distance from which on obstacles are all the same."""


@options
class BridgeDwaOptions:
    """Options of `bridge_dwa`."""

    max_speed: Positive = 1.4
    """m/s."""
    max_turn_rate: Positive = 2.0
    """rad/s."""
    acceleration: Positive = 4.0
    """m/s^2."""
    turn_acceleration: Positive = 8.0
    """rad/s^2."""
    horizon: Positive = 1.0
    """s for which each arc is followed."""
    nose: NonNegative = 0.3
    """m before the rover at which progress is measured, so that it turns the right way."""
    clearance: NonNegative = 0.1
    """m around the rover's turning disc that paths keep free, and within which obstacles cost something."""
    caution: NonNegative = 2.0
    """m of progress given up per m of missing clearance."""
    margin: NonNegative = 0.04
    """m around the rover's turning disc that must be free until it could stop."""
    memory: NonNegative = 8.0
    """s for which obstacles out of view are remembered."""
    replan_steps: Count = 3
    """Control steps between two computations of the shortest paths."""
    samples: Count = 5
    """Number of linear velocities tried, and about half of that of angular ones."""


@made_for("armctl/BridgeCross* armctl/BarnCross*", controls="rover")
@sees("model", family="DWA")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """Dynamic window approach on the depth camera's ranges, along shortest paths around what it has seen."""
    checked = changed_options(BridgeDwaOptions(), options, "option of bridge_dwa")
    return PerWorld([BridgeDwa(BridgeView("bridge_dwa", env), checked) for _ in range(env.num_envs)])


class SeenMap(BridgeMap):
    """A bridge of many small obstacles and without barriers, as a camera has seen it."""

    def free(self, x: Array, y: Array, clearance: float) -> NDArray[np.bool_]:
        """Return which points of a lattice have a clearance (m) from the obstacles."""
        free = np.empty((len(x), len(y)), dtype=bool)
        kernel.keep_clear(self.blocks, x, y, clearance, free)
        return free


def distances_to(obstacles: Array, points: Array) -> Array:
    """Return the distances (...,) m of points (..., 2) to the nearest of obstacles (k, 2), m; at most `FAR`."""
    distances = np.empty(points.shape[:-1])
    kernel.nearest_distances(obstacles, points.reshape(-1, 2), FAR, distances.reshape(-1))
    return distances


class BridgeDwa:
    """Crosses one bridge."""

    def __init__(self, view: BridgeView, options: BridgeDwaOptions) -> None:
        self._view, self._options = view, options
        steps = round(options.horizon / CONTROL_PERIOD)
        self._clock = np.array([CONTROL_PERIOD * step for step in range(1, steps + 1)])
        self._lattice = Lattice(view.goal_x + 1.0, view.half_width + DRIFT)
        self.reset()

    def reset(self) -> None:
        """Forget all obstacles."""
        self._view.reset()
        self._steps, self._horizon = 0, np.zeros((0, 3))

    def plans(self) -> dict[str, Array]:
        """Return the chosen arc, (m, 3) m."""
        return {"horizon": self._horizon}

    def act(self, observation: Mapping[str, Any]) -> Array:
        """Return linear (m/s) and angular velocity (rad/s)."""
        options, view = self._options, self._view
        view.update(observation, options.memory)
        if self._steps % options.replan_steps == 0:
            seen_map = SeenMap(self._lattice.length, self._lattice.half_width, np.pad(view.obstacles, ((0, 0), (0, 3))))
            self._lengths = self._lattice.lengths(seen_map, view.goal_x, RADIUS + options.clearance)
        self._steps += 1
        change = CONTROL_PERIOD * np.array((options.acceleration, options.turn_acceleration))
        limits = np.array((options.max_speed, options.max_turn_rate))
        linear, angular = dynamic_window(view.velocity, change, limits, options.samples)
        places, yaws = arcs(view.pose, linear, angular, self._clock)
        room = distances_to(view.obstacles, places) - RADIUS
        until_stopped = self._clock <= (linear / options.acceleration + 2 * CONTROL_PERIOD)[:, None]
        admissible = np.where(until_stopped, room, np.inf).min(axis=1) >= options.margin
        noses = places[:, -1] + options.nose * np.column_stack((np.cos(yaws), np.sin(yaws)))
        lengths = self._lattice.interpolate(np.broadcast_to(self._lengths, (len(noses), *self._lengths.shape)), noses)
        missing = np.clip(options.clearance - room.min(axis=1), 0.0, None)
        cost = lengths + options.caution * missing + np.where(admissible, 0.0, 1e3 * (1 + linear))
        best = int(cost.argmin())
        self._horizon = np.pad(places[best], ((0, 0), (0, 1)))
        if np.hypot(linear[best], angular[best]) < STUCK:
            view.forget()
            return np.array((0.0, options.max_turn_rate / 2))
        return np.array((linear[best], angular[best]))
