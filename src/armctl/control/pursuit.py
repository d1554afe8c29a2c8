"""Regulated pure pursuit: steer along the circle to a point ahead on the path, and slow down before curves.

Macenski, Singh, Martín, Ginés: Regulated pure pursuit for robot path tracking, Autonomous Robots 47, 2023. They slow
down in a curve. A fast skid-steer robot has to slow down before it, so the path has a speed profile here.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from armctl.control.arc_path import ArcPath
from armctl.core.arrays import Array
from armctl.core.options import NonNegative, Positive, options

PROFILE_STEP = 0.05
"""m: resolution of the speed profile"""
PREVIEW = 0.1
"""s: approximate delay until a command takes effect"""


@options
class PursuitOptions:
    """Options of `RegulatedPurePursuit`."""

    max_speed: Positive = 1.8
    """m/s."""
    max_turn_rate: Positive = 2.5
    """rad/s."""
    look_ahead_time: NonNegative = 0.25
    """s: look-ahead distance per speed."""
    look_ahead: tuple[Positive, Positive] = (0.3, 0.5)
    """Shortest and longest look-ahead, m."""
    lateral_acceleration: Positive = 1.5
    """m/s^2: limits the speed in a curve."""
    deceleration: Positive = 2.5
    """m/s^2: deceleration before a curve."""
    bend: Positive = 0.4
    """m: path length over which a corner is treated as a curve."""
    slowest: Positive = 0.3
    """m/s: minimum speed in any curve."""
    turn_first: Positive = 1.0
    """rad: heading error above which the robot turns on the spot."""
    search: Positive = 1.5
    """m: how far ahead of the last nearest point the next is searched."""


class RegulatedPurePursuit:
    """Follows one path (m, 2), m, of at least two points, extended straight beyond its end.

    Raises `ConfigurationError` for an invalid path.
    """

    def __init__(self, path: ArrayLike, options: PursuitOptions | None = None) -> None:
        self.options = options or PursuitOptions()
        self.path = ArcPath(path)
        self._profile_arc, self._profile = self._speed_profile()
        self.progress = 0.0
        """Arc length (m) of the path's point nearest to the robot; it never decreases."""

    def limit(self, options: PursuitOptions) -> None:
        """Go on along the path with other options."""
        self.options = options
        self._profile_arc, self._profile = self._speed_profile()

    def command(self, pose: ArrayLike, speed: float) -> tuple[float, float]:
        """Return linear (m/s) and angular velocity (rad/s) for a pose x, y (m), yaw (rad) and a speed (m/s)."""
        x, y, yaw = (float(number) for number in np.asarray(pose))
        options = self.options
        self._advance(x, y)
        ahead = float(np.clip(options.look_ahead_time * abs(speed), *options.look_ahead))
        goal_x, goal_y = self.path.points_at(self.progress + ahead).tolist()
        distance = math.hypot(goal_x - x, goal_y - y)
        error = (math.atan2(goal_y - y, goal_x - x) - yaw + math.pi) % (2 * math.pi) - math.pi
        if abs(error) > options.turn_first:
            return 0.0, math.copysign(min(options.max_turn_rate, 3.0 * abs(error)), error)
        curvature = 2 * math.sin(error) / max(distance, 1e-6)
        linear = float(np.interp(self.progress + PREVIEW * abs(speed), self._profile_arc, self._profile))
        if abs(linear * curvature) > options.max_turn_rate:
            linear = options.max_turn_rate / abs(curvature)
        return linear, linear * curvature

    def _speed_profile(self) -> tuple[Array, Array]:
        """Return arc lengths (m), and the speed limit (m/s) there."""
        options = self.options
        arc = np.arange(0.0, self.path.length + PROFILE_STEP, PROFILE_STEP)
        previous, point, following = (
            self.path.points_at(arc + offset) for offset in (-options.bend / 2, 0.0, options.bend / 2)
        )
        headings = [np.arctan2(chord[:, 1], chord[:, 0]) for chord in (point - previous, following - point)]
        turn = np.abs((headings[1] - headings[0] + np.pi) % (2 * np.pi) - np.pi)
        allowed = np.sqrt(options.lateral_acceleration * options.bend / np.maximum(turn, 1e-9))
        speed = np.clip(allowed, options.slowest, options.max_speed)
        for i in range(len(arc) - 2, -1, -1):
            speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2 * options.deceleration * PROFILE_STEP))
        return arc, speed

    def _advance(self, x: float, y: float) -> None:
        """Move `progress` to the nearest point within reach ahead."""
        self.progress = float(self.path.nearest((x, y), self.progress, self.progress + self.options.search))
