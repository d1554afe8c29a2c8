"""The OMPL expert: a path with clearance over the bridge's map, followed at speed by regulated pure pursuit.

Path and speed are chosen one after the other (Kant and Zucker, Toward efficient trajectory planning: the path-velocity
decomposition, IJRR 5(3), 1986). The path passes beside the lanes along the bridge. Lanes across it are entered at the
highest speed at which no predicted pedestrian comes near until the rover is clear of all lanes. It sees the map and the
true pose, which are privileged state.
"""

import functools
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.bridge_controllers import (
    MAP_TOLERANCE,
    MAX_ACCELERATION,
    BridgePolicy,
    distance_from_path,
    map_distance,
    path_from,
)
from armctl.control import PursuitOptions, RegulatedPurePursuit
from armctl.control.drive_limits import DriveLimits
from armctl.core.arrays import Array
from armctl.core.options import NonNegative, Positive, changed_options, options
from armctl.envs import TaskVectorEnv
from armctl.policies import made_for, sees
from armctl.robots.rover import RADIUS
from armctl.scene import BridgeMap
from armctl.tasks.bridge import CONTROL_PERIOD

MARGIN = 0.2
"""m: distance between the rover and pedestrians."""
ACCELERATION = 4.0
"""m/s^2: assumed acceleration of the rover."""
SPEEDS = (1.0, 0.8, 0.6, 0.4, 0.25, 0.0)
"""Fractions of the pursuit's speed to try, the highest first."""
FORESIGHT = 5.0
"""s: prediction horizon."""
REPLAN_DISTANCE = 0.4
"""m: distance from the path at which a new one is planned."""


@options
class BridgeOmplOptions:
    """Options of `BridgeOmpl`."""

    prepared: bool = True
    """Preparation for delays, noise, and rovers that are weaker or more slippery than the model."""
    look_ahead_time: NonNegative = 0.25
    """s: look-ahead distance per speed."""
    lateral_acceleration: Positive = 1.5
    """m/s^2: limits the speed in a curve."""


@made_for("armctl/BridgeCross* armctl/BarnCross*", controls="rover")
@sees("state", family="OMPL", foresight="pedestrians")
def make(env: TaskVectorEnv, options: Mapping[str, Any] = MappingProxyType({})) -> BridgePolicy:
    """OMPL path on the true map, and pure pursuit; waits for pedestrians who cross the path."""
    chosen = changed_options(BridgeOmplOptions(), options, "option of bridge_ompl")
    return BridgePolicy("bridge_ompl", env, functools.partial(BridgeOmpl, options=chosen), chosen.prepared)


class BridgeOmpl:
    """Crosses one bridge."""

    def __init__(self, bridge: BridgeMap, goal_x: float, options: BridgeOmplOptions | None = None) -> None:
        chosen = options or BridgeOmplOptions()
        self._goal_x, self._usual = (
            goal_x,
            PursuitOptions(look_ahead_time=chosen.look_ahead_time, lateral_acceleration=chosen.lateral_acceleration),
        )
        self.see(bridge)
        self._planned_for, self._margin, self._acceleration = bridge, 0.0, ACCELERATION
        self._options = self._usual
        self._path: Array | None = None
        self._pursuit: RegulatedPurePursuit | None = None

    def plans(self) -> dict[str, Array]:
        """Return the path, (m, 2) m."""
        return {} if self._path is None else {"path": self._path}

    def see(self, bridge: BridgeMap) -> None:
        """Go by this map from now on."""
        self._bridge, self._crossing = bridge, bridge.pedestrians.across()

    def limit(self, limits: DriveLimits) -> None:
        """Keep these limits from now on: drive slowly enough for curves, and along another path for another map."""
        moved = map_distance(self._bridge, self._planned_for) > MAP_TOLERANCE
        if moved or limits.margin != self._margin:
            self._pursuit, self._margin = None, limits.margin
        self._acceleration = min(ACCELERATION, limits.max_acceleration)
        share = limits.max_acceleration / MAX_ACCELERATION
        if share < 1 or limits.max_speed < self._usual.max_speed or limits.max_turn_rate < self._usual.max_turn_rate:
            options = replace(
                self._usual,
                max_speed=min(self._usual.max_speed, limits.max_speed),
                max_turn_rate=min(self._usual.max_turn_rate, limits.max_turn_rate),
                lateral_acceleration=share * self._usual.lateral_acceleration,
                deceleration=share * self._usual.deceleration,
            )
        else:
            options = self._usual
        if self._pursuit and options != self._options:
            self._pursuit.limit(options)
        self._options = options

    def act(self, pose: Array, velocity: Array, time: float) -> tuple[float, float]:
        """Return linear and angular velocity for a pose (x, y, yaw), current velocities (m/s, rad/s) and time (s)."""
        speed = float(velocity[0])
        if self._pursuit is None or distance_from_path(self._pursuit, pose) > REPLAN_DISTANCE:
            path = path_from(self._bridge, pose[:2], self._goal_x, self._margin)
            if not len(path):
                return 0.0, 0.0
            self._path, self._pursuit = path, RegulatedPurePursuit(path, self._options)
            self._planned_for = self._bridge
        linear, angular = self._pursuit.command(pose, speed)
        if linear == 0.0 or not len(self._crossing.speed):
            return linear, angular
        share = self._highest_safe_share(self._pursuit, linear, speed, time)
        return share * linear, share * angular

    def _highest_safe_share(self, pursuit: RegulatedPurePursuit, linear: float, speed: float, time: float) -> float:
        """Return the highest fraction of the speed at which the rover meets no one until it is clear of all lanes."""
        shares, rate = np.array(SPEEDS), self._acceleration
        clock = np.arange(0.0, FORESIGHT, 0.05)
        targets = shares[:, None] * linear
        change = np.abs(targets - speed) / rate
        travelled = np.where(
            clock < change,
            speed * clock + np.sign(targets - speed) * rate * clock**2 / 2,
            speed * change + np.sign(targets - speed) * rate * change**2 / 2 + targets * (clock - change),
        )
        points = pursuit.path.points_at(pursuit.progress + travelled)
        people = self._crossing.positions(time + clock)
        distances = np.linalg.norm(points[:, :, None] - people, axis=-1).min(axis=-1)
        room = distances - RADIUS - self._crossing.radius
        stops = pursuit.path.points_at(pursuit.progress + travelled + targets**2 / (2 * rate))
        refuge = self._off_all_lanes(points) & self._off_all_lanes(stops) & (clock >= CONTROL_PERIOD)
        until = np.where(refuge.any(axis=1), refuge.argmax(axis=1), len(clock) - 1)
        closest = np.array([row[: last + 1].min() for row, last in zip(room, until, strict=True)])
        safe = (closest >= MARGIN) & refuge.any(axis=1)
        return float(shares[safe.argmax()] if safe.any() else shares[closest.argmax()])

    def _off_all_lanes(self, points: Array) -> NDArray[np.bool_]:
        room = RADIUS + self._crossing.radius + MARGIN / 2
        low, high = points.min(axis=(0, 1)) - room, points.max(axis=(0, 1)) + room
        first, last = np.split(self._crossing.lanes, 2, axis=1)
        near = (np.minimum(first, last) <= high).all(axis=1) & (np.maximum(first, last) >= low).all(axis=1)
        first, lane = first[near], (last - first)[near]
        offset = points[..., None, :] - first
        share = np.clip((offset * lane).sum(axis=-1) / (lane * lane).sum(axis=-1), 0.0, 1.0)
        distance = np.linalg.norm(offset - share[..., None] * lane, axis=-1).min(axis=-1, initial=np.inf)
        return np.asarray(distance >= room)
