"""The MPC expert: OMPL's path over the bridge's map, driven by nonlinear model predictive control.

It keeps away from what stands by half-planes, and from people by where they are predicted to be over the horizon: it
slows down for them, or goes around them. The path passes beside lanes along the bridge.
It sees the map and the true pose: privileged state.
"""

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.bridge_controllers import BridgePolicy, path_from
from armctl.control.drive_mpc import DriveMpc, DriveMpcOptions
from armctl.envs import TaskVectorEnv
from armctl.robots.rover import MAX_VELOCITY, MAX_WHEEL_SPEED, RADIUS, TRACK, WHEEL_RADIUS, WHEEL_SEPARATION_MULTIPLIER
from armctl.scene import BridgeMap
from armctl.tasks.bridge import CONTROL_PERIOD

Array = NDArray[np.float64]

MARGIN = 0.04
"""m kept between the rover and whatever stands."""
PEOPLE_MARGIN = 0.15
"""m kept between the rover and whoever walks."""
ACCELERATION = 4.0
"""m/s^2. The rover can do 5.5, up and down. With no more than 4 it has the commanded speed (0.97 to 0.99 of it) within
the period, and the yaw rate (0.9 to 1.1) sooner: 99 % of predictions for the next decision are within 2 cm."""
REPLAN_DISTANCE = 1.0
"""m off the path, from where a new one is planned."""


def make(env: TaskVectorEnv) -> BridgePolicy:
    """OMPL path on the true map, and nonlinear MPC along it, around people where they are predicted to be."""
    return BridgePolicy("bridge_mpc", env, BridgeController)


class BridgeController:
    """Crosses one bridge."""

    def __init__(self, bridge: BridgeMap, goal_x: float) -> None:
        self._bridge, self._goal_x = bridge, goal_x
        self._options = DriveMpcOptions(
            max_speed=float(MAX_VELOCITY[0]),
            max_acceleration=ACCELERATION,
            max_rim_speed=MAX_WHEEL_SPEED * WHEEL_RADIUS,
            half_track=TRACK * WHEEL_SEPARATION_MULTIPLIER / 2,
            clearance=RADIUS + MARGIN,
            distance=RADIUS + bridge.pedestrians.radius + PEOPLE_MARGIN,
            period=CONTROL_PERIOD,
        )
        self._clock = CONTROL_PERIOD * np.arange(self._options.steps + 1)
        self._mpc: DriveMpc | None = None
        self._plans: dict[str, Array] = {}
        self._failed_before = 0

    @property
    def failures(self) -> int:
        """Decisions without a solution, in which the rover braked."""
        return self._failed_before + (self._mpc.failures if self._mpc else 0)

    def plans(self) -> dict[str, Array]:
        """The path (m, 2) and where the rover is predicted to be, (steps + 1, 2), m."""
        return self._plans

    def act(self, pose: Array, velocity: Array, time: float) -> tuple[float, float]:
        """Linear and angular velocity for a pose (x, y, yaw), the present velocities (m/s, rad/s) and time (s)."""
        if self._mpc is None or self._strayed(self._mpc, pose):
            path = path_from(self._bridge, pose[:2], self._goal_x)
            if not len(path):
                return 0.0, 0.0
            self._failed_before = self.failures
            self._mpc = DriveMpc(path, self._bridge.nearest, self._options)
            self._plans["path"] = path
        decision = self._mpc.decide(pose, velocity, self._bridge.pedestrians.positions(time + self._clock))
        self._plans["horizon"] = decision.poses[:, :2]
        return decision.command

    def _strayed(self, mpc: DriveMpc, pose: Array) -> bool:
        return bool(np.linalg.norm(mpc.path.points_at(mpc.progress) - pose[:2]) > REPLAN_DISTANCE)
