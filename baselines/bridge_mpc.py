"""The MPC expert: OMPL's path over the bridge's map, followed by nonlinear model predictive control.

Half-planes keep it away from static obstacles. It predicts pedestrians over the horizon, and slows down for them or
goes around them. The path passes beside the lanes along the bridge. It sees the map and the true pose, which are
privileged state.
"""

import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from armctl.baselines.bridge_controllers import BridgePolicy, distance_from_path, path_from
from armctl.control.drive_mpc import DriveMpc, DriveMpcOptions
from armctl.core.arrays import Array
from armctl.core.options import changed_options
from armctl.envs import TaskVectorEnv
from armctl.policies import made_for, sees
from armctl.robots.rover import MAX_VELOCITY, MAX_WHEEL_SPEED, RADIUS, TRACK, WHEEL_RADIUS, WHEEL_SEPARATION_MULTIPLIER
from armctl.scene import BridgeMap
from armctl.tasks.bridge import CONTROL_PERIOD

MARGIN = 0.04
"""m: distance between the rover and static obstacles."""
PEOPLE_MARGIN = 0.15
"""m: distance between the rover and pedestrians."""
ACCELERATION = 4.0
"""m/s^2. The rover can accelerate and brake at 5.5. With at most 4, it reaches the commanded speed (0.97 to 0.99 of it)
within the period, and the yaw rate (0.9 to 1.1) earlier: 99 % of predictions of the next pose are within 2 cm."""
REPLAN_DISTANCE = 1.0
"""m: distance from the path at which a new one is planned."""


@made_for("armctl/BridgeCross*", controls="rover")
@sees("state", family="MPC", foresight="pedestrians")
def make(env: TaskVectorEnv, options: Mapping[str, Any] = MappingProxyType({})) -> BridgePolicy:
    """OMPL path on the true map, and nonlinear MPC along it, around the predicted pedestrians."""
    return BridgePolicy("bridge_mpc", env, functools.partial(BridgeMpc, options=options))


class BridgeMpc:
    """Crosses one bridge. `options` are those of `DriveMpcOptions` that differ from the ones here."""

    def __init__(self, bridge: BridgeMap, goal_x: float, options: Mapping[str, Any] = MappingProxyType({})) -> None:
        self._bridge, self._goal_x = bridge, goal_x
        usual = DriveMpcOptions(
            max_speed=float(MAX_VELOCITY[0]),
            max_acceleration=ACCELERATION,
            max_rim_speed=MAX_WHEEL_SPEED * WHEEL_RADIUS,
            half_track=TRACK * WHEEL_SEPARATION_MULTIPLIER / 2,
            clearance=RADIUS + MARGIN,
            distance=RADIUS + bridge.pedestrians.radius + PEOPLE_MARGIN,
            period=CONTROL_PERIOD,
        )
        self._options = changed_options(usual, options, "option of bridge_mpc")
        self._clock = CONTROL_PERIOD * np.arange(self._options.steps + 1)
        self._mpc: DriveMpc | None = None
        self._plans: dict[str, Array] = {}
        self._failed_before = 0

    @property
    def failures(self) -> int:
        """Control steps without a solution, in which the rover braked."""
        return self._failed_before + (self._mpc.failures if self._mpc else 0)

    def plans(self) -> dict[str, Array]:
        """Return the path (m, 2) and the predicted positions (steps + 1, 2) of the rover, m."""
        return self._plans

    def see(self, bridge: BridgeMap) -> None:
        """Go by this map from now on."""
        self._bridge = bridge

    def act(self, pose: Array, velocity: Array, time: float) -> tuple[float, float]:
        """Return linear and angular velocity for a pose (x, y, yaw), current velocities (m/s, rad/s) and time (s)."""
        if self._mpc is None or distance_from_path(self._mpc, pose) > REPLAN_DISTANCE:
            path = path_from(self._bridge, pose[:2], self._goal_x)
            if not len(path):
                return 0.0, 0.0
            self._failed_before = self.failures
            self._mpc = DriveMpc(path, lambda points: self._bridge.nearest(points), self._options)
            self._plans["path"] = path
        result = self._mpc.decide(pose, velocity, self._bridge.pedestrians.positions(time + self._clock))
        self._plans["horizon"] = result.poses[:, :2]
        return result.command
