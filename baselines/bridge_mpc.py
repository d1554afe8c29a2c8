"""The MPC expert: OMPL's path over the bridge's map, followed by nonlinear model predictive control.

Half-planes keep it away from static obstacles. It predicts pedestrians over the horizon, and slows down for them or
goes around them. The path passes beside the lanes along the bridge. It sees the map and the true pose, which are
privileged state.
"""

import functools
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from armctl.baselines.bridge_controllers import (
    MAP_TOLERANCE,
    BridgePolicy,
    distance_from_path,
    map_distance,
    path_from,
)
from armctl.baselines.bridge_slow_turner import SlowTurner
from armctl.control.drive_limits import DriveLimits
from armctl.control.drive_mpc import DriveMpc, DriveMpcOptions
from armctl.control.pursuit import PursuitOptions, RegulatedPurePursuit
from armctl.core.arrays import Array
from armctl.core.options import changed_options, options
from armctl.envs import TaskVectorEnv
from armctl.estimation.drive_observer import SLOW_TURN_RATE
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
STANDING, MAX_STANDING = 0.1, 15
"""m/s or rad/s, and control steps: a prepared rover that is slower for longer plans another path."""
ESCAPE, ESCAPE_TIME = PursuitOptions(max_speed=0.5, max_turn_rate=1.0, turn_first=0.2), 2.0
"""Pursuit of the new path by a rover that stood, and for how long, s: it turns on the spot, where MPC sees no way."""
FAR_STEPS, FAR_PERIOD = 40, 0.2
"""A rover that turns slowly among people looks so many steps of so many s ahead."""


@made_for("armctl/BridgeCross* armctl/BarnCross*", controls="rover")
@sees("state", family="MPC", foresight="pedestrians")
def make(env: TaskVectorEnv, options: Mapping[str, Any] = MappingProxyType({})) -> BridgePolicy:
    """OMPL path on the true map, and nonlinear MPC along it, around the predicted pedestrians."""
    prepared = changed_options(BridgeMpcOptions(), options, "option of bridge_mpc").prepared
    return BridgePolicy("bridge_mpc", env, functools.partial(BridgeMpc, options=options), prepared)


@options
class BridgeMpcOptions(DriveMpcOptions):
    """Options of `BridgeMpc`."""

    prepared: bool = True
    """Preparation for delays, noise, and rovers that are weaker or more slippery than the model."""


class BridgeMpc:
    """Crosses one bridge. `options` are those of `BridgeMpcOptions` that differ from the ones here."""

    def __init__(self, bridge: BridgeMap, goal_x: float, options: Mapping[str, Any] = MappingProxyType({})) -> None:
        self._bridge, self._goal_x = bridge, goal_x
        usual = BridgeMpcOptions(
            max_speed=float(MAX_VELOCITY[0]),
            max_acceleration=ACCELERATION,
            max_rim_speed=MAX_WHEEL_SPEED * WHEEL_RADIUS,
            half_track=TRACK * WHEEL_SEPARATION_MULTIPLIER / 2,
            clearance=RADIUS + MARGIN,
            distance=RADIUS + bridge.pedestrians.radius + PEOPLE_MARGIN,
            period=CONTROL_PERIOD,
        )
        self._options = changed_options(usual, options, "option of bridge_mpc")
        self._mpc: DriveMpc | None = None
        self._far_sighted = replace(self._options, steps=FAR_STEPS, period=FAR_PERIOD)
        self._limits: DriveLimits | None = None
        self._planned_for, self._standing = bridge, 0
        self._escape: tuple[RegulatedPurePursuit, float] | None = None
        self._slow_turner = SlowTurner(goal_x)
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

    def limit(self, limits: DriveLimits) -> None:
        """Keep these limits from now on."""
        if self._limits and _kind(limits) != _kind(self._limits):
            self._failed_before, self._mpc = self.failures, None
        self._limits = limits

    def act(self, pose: Array, velocity: Array, time: float) -> tuple[float, float]:
        """Return linear and angular velocity for a pose (x, y, yaw), current velocities (m/s, rad/s) and time (s)."""
        if self._limits and _turns_slowly(self._limits) and not len(self._bridge.pedestrians.speed):
            command: tuple[float, float] | None = self._slow_turner.act(self._bridge, pose, velocity, self._limits)
            if command and self._slow_turner.path:
                self._plans = {"path": self._slow_turner.path.segments[:, 1:3]}
                return command
        if self._mpc is None or distance_from_path(self._mpc, pose) > REPLAN_DISTANCE or self._is_stuck(velocity):
            path = path_from(self._bridge, pose[:2], self._goal_x, self._limits.margin if self._limits else 0.0)
            if not len(path):
                return 0.0, 0.0
            self._failed_before = self.failures
            self._planned_for, self._standing = self._bridge, 0
            options = self._far_sighted if self._limits and _turns_slowly(self._limits) else self._options
            self._mpc = DriveMpc(path, lambda points: self._bridge.nearest(points), options)
            self._plans["path"] = path
            if self._limits and np.abs(velocity).max() < STANDING and time > ESCAPE_TIME:
                self._escape = RegulatedPurePursuit(path, ESCAPE), time + ESCAPE_TIME
        if self._escape and time < self._escape[1]:
            return self._escape[0].command(pose, float(velocity[0]))
        if self._limits:
            self._mpc.limit(self._limits)
        clock = self._mpc.options.period * np.arange(self._mpc.options.steps + 1)
        result = self._mpc.decide(pose, velocity, self._bridge.pedestrians.positions(time + clock))
        self._plans["horizon"] = result.poses[:, :2]
        return result.command

    def _is_stuck(self, velocity: Array) -> bool:
        """Return True if another path is needed: the rover stands, or the map has changed since it was planned."""
        if self._limits is None:
            return False
        if len(self._bridge.pedestrians.speed):  # who stands lets people pass
            velocity = np.full(2, np.inf)
        self._standing = self._standing + 1 if np.abs(velocity).max() < STANDING else 0
        return self._standing > MAX_STANDING or map_distance(self._bridge, self._planned_for) > MAP_TOLERANCE


def _kind(limits: DriveLimits) -> tuple[bool, float]:
    """Return what another path is planned for."""
    return _turns_slowly(limits), limits.margin


def _turns_slowly(limits: DriveLimits) -> bool:
    return bool(limits.max_turn_rate < SLOW_TURN_RATE)
