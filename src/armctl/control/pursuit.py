"""Regulated pure pursuit: steer along the circle to a point ahead on the path, and slow down where the path is bent.

Macenski, Singh, Martín, Ginés: Regulated pure pursuit for robot path tracking, Autonomous Robots 47, 2023.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.errors import ConfigurationError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PursuitOptions:
    """Options of `RegulatedPurePursuit`."""

    max_speed: float = 1.8
    """m/s."""
    max_turn_rate: float = 2.5
    """rad/s."""
    look_ahead_time: float = 0.3
    """s ahead at the present speed."""
    look_ahead: tuple[float, float] = (0.3, 0.6)
    """Shortest and longest look-ahead, m."""
    slow_radius: float = 0.9
    """Curves of a smaller radius are driven in proportion slower, m."""
    slowest: float = 0.25
    """m/s, in any curve."""
    turn_first: float = 1.0
    """Error of heading above which the robot turns on the spot, rad."""
    search: float = 1.5
    """How far ahead of the last nearest point the next is looked for, m."""


class RegulatedPurePursuit:
    """Follows one path (m, 2), m, of at least two points, and straight on beyond its end."""

    def __init__(self, path: ArrayLike, options: PursuitOptions | None = None) -> None:
        points = np.asarray(path, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
            raise ConfigurationError(f"a path is an array (m, 2) of at least two finite points, not {path!r}")
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        keep = np.concatenate(([True], steps > 1e-9))
        if keep.sum() < 2:
            raise ConfigurationError("a path leads somewhere else than where it begins")
        self.options = options or PursuitOptions()
        self._points = points[keep]
        self._arc = np.concatenate(([0.0], np.cumsum(steps[keep[1:]])))
        self._ways = np.diff(self._points, axis=0) / np.diff(self._arc)[:, None]
        self.progress = 0.0
        """Arc length of the path's point nearest to the robot, m; it never goes back."""

    @property
    def length(self) -> float:
        """Of the path, m."""
        return float(self._arc[-1])

    def points_at(self, arc_lengths: ArrayLike) -> Array:
        """Points (..., 2) of the path at arc lengths (...), m."""
        arc = np.asarray(arc_lengths, dtype=float)
        segment = np.clip(np.searchsorted(self._arc, arc, side="right") - 1, 0, len(self._ways) - 1)
        return np.asarray(self._points[segment] + self._ways[segment] * (arc - self._arc[segment])[..., None])

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
        regulated = options.max_speed * min(1.0, 1.0 / max(abs(curvature) * options.slow_radius, 1e-9))
        linear = max(regulated, options.slowest)
        if abs(linear * curvature) > options.max_turn_rate:
            linear = options.max_turn_rate / abs(curvature)
        return linear, linear * curvature

    def _advance(self, x: float, y: float) -> None:
        """Move `progress` to the nearest point within reach ahead."""
        arc = self.progress + np.linspace(0.0, self.options.search, 61)
        near = self.points_at(arc) - (x, y)
        self.progress = float(arc[np.argmin((near * near).sum(axis=1))])
