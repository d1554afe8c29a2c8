"""Pure pursuit, regulated: steer along the circle to a point ahead on the path, and slow down before it bends.

Macenski, Singh, Martín, Ginés: Regulated pure pursuit for robot path tracking, Autonomous Robots 47, 2023. They slow
down in a curve; a skid-steer robot at speed has to do so before it, so that here the path has a speed profile.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.control.arc_path import ArcPath

Array = NDArray[np.float64]


PROFILE_STEP = 0.05
"""m between the points of the speed profile."""
PREVIEW = 0.1
"""s: commands take about that long to tell."""


@dataclass(frozen=True)
class PursuitOptions:
    """Options of `RegulatedPurePursuit`."""

    max_speed: float = 1.8
    """m/s."""
    max_turn_rate: float = 2.5
    """rad/s."""
    look_ahead_time: float = 0.25
    """s ahead at the present speed."""
    look_ahead: tuple[float, float] = (0.3, 0.5)
    """Shortest and longest look-ahead, m."""
    lateral_acceleration: float = 1.5
    """m/s^2, that limits the speed in a curve."""
    deceleration: float = 2.5
    """m/s^2 with which it slows down before one."""
    bend: float = 0.4
    """Length of path over which a corner is taken to be a curve, m."""
    slowest: float = 0.3
    """m/s, in any curve."""
    turn_first: float = 1.0
    """Error of heading above which the robot turns on the spot, rad."""
    search: float = 1.5
    """How far ahead of the last nearest point the next is looked for, m."""


class RegulatedPurePursuit:
    """Follows one path (m, 2), m, of at least two points, and straight on beyond its end.

    Raises `ConfigurationError` for a path that is none.
    """

    def __init__(self, path: ArrayLike, options: PursuitOptions | None = None) -> None:
        self.options = options or PursuitOptions()
        self._path = ArcPath(path)
        self._profile_arc, self._profile = self._speed_profile()
        self.progress = 0.0
        """Arc length of the path's point nearest to the robot, m; it never goes back."""

    @property
    def length(self) -> float:
        """Of the path, m."""
        return self._path.length

    def points_at(self, arc_lengths: ArrayLike) -> Array:
        """Points (..., 2) of the path at arc lengths (...), m."""
        return self._path.points_at(arc_lengths)

    def command(self, pose: ArrayLike, speed: float) -> tuple[float, float]:
        """Linear (m/s) and angular velocity (rad/s) for a pose x, y (m), yaw (rad) and the present speed (m/s)."""
        x, y, yaw = (float(number) for number in np.asarray(pose))
        options = self.options
        self._advance(x, y)
        ahead = float(np.clip(options.look_ahead_time * abs(speed), *options.look_ahead))
        goal_x, goal_y = self.points_at(self.progress + ahead).tolist()
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
        """Arc lengths, and how fast the path may be driven there."""
        options = self.options
        arc = np.arange(0.0, self.length + PROFILE_STEP, PROFILE_STEP)
        before, here, after = (self.points_at(arc + offset) for offset in (-options.bend / 2, 0.0, options.bend / 2))
        headings = [np.arctan2(way[:, 1], way[:, 0]) for way in (here - before, after - here)]
        turn = np.abs((headings[1] - headings[0] + np.pi) % (2 * np.pi) - np.pi)
        allowed = np.sqrt(options.lateral_acceleration * options.bend / np.maximum(turn, 1e-9))
        speed = np.clip(allowed, options.slowest, options.max_speed)
        for i in range(len(arc) - 2, -1, -1):
            speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2 * options.deceleration * PROFILE_STEP))
        return arc, speed

    def _advance(self, x: float, y: float) -> None:
        """Move `progress` to the nearest point within reach ahead."""
        self.progress = float(self._path.nearest((x, y), self.progress, self.progress + self.options.search))
