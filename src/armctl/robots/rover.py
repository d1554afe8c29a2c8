"""A simulated skid-steer rover: from velocity commands to wheels, and from the simulation to sensor readings."""

from typing import Any

import mujoco
import numpy as np

from armctl.core.arrays import Array
from armctl.robots.joints import ActuatorLimits, JointSamples
from armctl.simulation import Simulation
from armctl.simulation.planning_model import Step
from armctl.simulation.worlds import world_path

PREFIX = "rover/"
"""Prefix of the rover's names in a world's model."""
WHEELS = ("front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel")
PARTS = ("base", *WHEELS)
CAMERA = PREFIX + "front"
CAMERA_AHEAD, CAMERA_PITCH = 0.215, float(np.radians(10.0))
"""m before the rover's centre, and rad by which the camera looks down at rest."""
GEOM_GROUP = 1
"""Group of the geoms that its own camera does not see."""

WHEEL_RADIUS = 0.098
"""m."""
TRACK = 0.37558
"""m: distance between left and right wheels"""
WHEEL_SEPARATION_MULTIPLIER = 1.6
"""Factor by which skidding wheels turn the rover less than rolling ones (measured on the asphalt)."""
MAX_WHEEL_SPEED = 25.0
"""rad/s."""
MAX_VELOCITY = np.array([2.0, 3.0])
"""Limits of commands: linear (m/s) and angular (rad/s)."""
SPEED_LIMITS = {PREFIX + wheel: MAX_WHEEL_SPEED for wheel in WHEELS}
"""rad/s, by the joints' names in a world's model."""
RADIUS = 0.31
"""m: from its centre to its farthest corner; it can turn in a disc of this radius"""


class Rover:
    """n simulated rovers, commanded together."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation, model = simulation, simulation.model
        self._qpos, self._qvel = simulation.array("qpos"), simulation.array("qvel")
        self._sensors, self._ctrl = simulation.array("sensordata"), simulation.array("ctrl")
        self._positions = simulation.array("xpos")
        free = model.joint(PREFIX + "base")
        self._pose_columns = slice(free.qposadr[0], free.qposadr[0] + 7)
        self._twist_columns = slice(free.dofadr[0], free.dofadr[0] + 6)
        spins = [int(model.joint(PREFIX + wheel).dofadr[0]) for wheel in WHEELS]
        self._spin_columns = slice(spins[0], spins[-1] + 1)
        self._motors = [model.actuator(PREFIX + wheel).id for wheel in WHEELS]
        self._wheel_bodies = [model.body(PREFIX + wheel).id for wheel in WHEELS]
        self._base = model.body(PREFIX + "base").id
        gyro = model.sensor(PREFIX + "gyro").adr[0]
        self._gyro_columns = slice(gyro, gyro + 3)

    def command(self, velocities: Array) -> None:
        """Set linear and angular velocities (n, 2), m/s and rad/s, clipped to `MAX_VELOCITY`.

        If a wheel would exceed its speed limit, both velocities are scaled down, which keeps the curvature.
        """
        self._ctrl[:, self._motors] = wheel_speeds(np.clip(velocities, -MAX_VELOCITY, MAX_VELOCITY))

    def wheel_samples(self, samples: int, period: float) -> JointSamples:
        """Return a recorder of the wheels with `samples` per control period (s)."""
        torque = self._simulation.model.actuator_forcerange[self._motors, 1]
        limits = ActuatorLimits(np.full(len(WHEELS), MAX_WHEEL_SPEED), torque)
        return JointSamples(self._simulation, self._spin_columns, limits, samples, period)

    @property
    def positions(self) -> Array:
        """Positions of the bases, (n, 3) m."""
        return self._positions[:, self._base]

    @property
    def poses(self) -> Array:
        """True x, y (m) and yaw (rad), (n, 3)."""
        x, y, _, qw, qx, qy, qz = self._qpos[:, self._pose_columns].T
        yaw = np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        return np.stack((x, y, yaw), axis=1)

    @property
    def upright(self) -> Array:
        """Cosine of the angle by which each base leans over, (n,): 1 on its wheels, 0 on its side."""
        _, _, _, _, qx, qy, _ = self._qpos[:, self._pose_columns].T
        return np.asarray(1 - 2 * (qx * qx + qy * qy))

    @property
    def velocities(self) -> Array:
        """True forward velocity (m/s) and yaw rate (rad/s), (n, 2)."""
        yaw = self.poses[:, 2]
        vx, vy, _, _, _, spin = self._qvel[:, self._twist_columns].T
        return np.stack((vx * np.cos(yaw) + vy * np.sin(yaw), spin), axis=1)

    def slip(self, world: int) -> tuple[Array, Array, float]:
        """Return a rover's true velocity in x and y (2,), the speeds of its wheels' rims (4,), m/s, and its pitch, rad.

        The pitch is positive if its nose is down.
        """
        _, _, _, w, x, y, z = self._qpos[world, self._pose_columns]
        pitch = float(np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)))
        velocity = self._qvel[world, self._twist_columns][:2].copy()
        return velocity, WHEEL_RADIUS * self._qvel[world, self._spin_columns], pitch

    @property
    def odometry(self) -> Array:
        """Linear (m/s) and angular velocity (rad/s) from the wheel speeds, (n, 2): wrong as far as they skid."""
        rim = WHEEL_RADIUS * self._qvel[:, self._spin_columns]
        left, right = (rim[:, 0] + rim[:, 2]) / 2, (rim[:, 1] + rim[:, 3]) / 2
        return np.stack(((left + right) / 2, (right - left) / (TRACK * WHEEL_SEPARATION_MULTIPLIER)), axis=1)

    @property
    def gyro(self) -> Array:
        """Angular velocity in the rover's frame, (n, 3) rad/s."""
        return self._sensors[:, self._gyro_columns]

    @property
    def wheel_heights(self) -> Array:
        """Heights of the wheel centres, (n, 4) m."""
        return self._positions[:, self._wheel_bodies, 2]


def driven_rovers(model: mujoco.MjModel, n: int, *, ticks: int, period: float) -> tuple[Simulation, Step]:
    """Make n worlds of rovers, and what makes their control steps, of `period` s and so many ticks."""
    simulation = Simulation(model, n, threads=1, speed_limits=SPEED_LIMITS)
    rover, substeps = Rover(simulation), round(period / ticks / model.opt.timestep)

    def step(actions: Array) -> None:
        rover.command(actions)
        simulation.control_step(ticks, substeps)

    return simulation, step


def wheel_speeds(velocities: Array) -> Array:
    """Return wheel speeds (n, 4) rad/s for linear and angular velocities (n, 2), m/s and rad/s."""
    linear, angular = velocities.T
    turning = angular * TRACK * WHEEL_SEPARATION_MULTIPLIER / 2
    sides = np.stack((linear - turning, linear + turning), axis=1) / WHEEL_RADIUS
    sides /= np.maximum(1.0, np.abs(sides).max(axis=1, keepdims=True) / MAX_WHEEL_SPEED)
    return np.tile(sides, 2)


def add_rover(spec: Any, position: tuple[float, float]) -> None:
    """Add the rover of `models/rover.xml` to a world, on the ground at x, y (m)."""
    rover = mujoco.MjSpec.from_file(str(world_path("rover")))
    spec.attach(rover, frame=spec.worldbody.add_frame(pos=[*position, 0.0]), prefix=PREFIX)
