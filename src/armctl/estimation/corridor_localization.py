"""Pose of a robot between two parallel walls: dead reckoning, corrected by what it sees of the walls.

An extended Kalman filter of the pose. Odometry predicts it; the points that are seen near a wall correct heading and
lateral position. Along the walls there is nothing to correct by, so that the error of the odometry remains.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from armctl.core.arrays import Array

GATE = 0.12
"""m: points farther from where a wall is expected are not of the wall, but for the doubt about the lateral position."""
POINT_STD = 0.08
"""m: error of one point's distance from its wall."""
MIN_STD = (0.01, 0.005)
"""m, rad: lateral position and heading are never known better, as errors of points are alike."""
SLIP = (0.05, 0.05, 0.15)
"""Standard deviations of forward (m/s) and lateral velocity (m/s) and yaw rate (rad/s)."""
INITIAL_STD = (0.05, 0.05, 0.03)
"""m, m, rad: error of the pose at the start."""
LOOKS = 3
"""Iterations of the correction, each with the points near the walls as they are then expected."""


@dataclass(frozen=True)
class Corridor:
    """Two walls at y = `half_width` m and its opposite; they lean outwards, `lean` m per m above `foot` m."""

    half_width: float
    lean: float = 0.0
    foot: float = 0.0

    def half_width_at(self, heights: Array) -> Array:
        """Return how far (m,) the walls are from the middle at heights (m,), m."""
        return self.half_width + self.lean * np.maximum(heights - self.foot, 0.0)


class CorridorLocalization:
    """Believed pose of a robot in a corridor.

    A robot that turns while it drives slides outwards: `slide` s times linear times angular velocity.
    """

    def __init__(self, pose: ArrayLike, corridor: Corridor, slide: float = 0.0) -> None:
        self.pose = np.array(pose, dtype=float)
        """x, y (m) and yaw (rad)."""
        self.covariance = np.diag(INITIAL_STD) ** 2
        self._corridor, self._slide = corridor, slide

    def predict(self, linear: float, angular: float, period: float) -> None:
        """Move by velocities (m/s, rad/s) over a period (s)."""
        turn = angular * period
        middle = self.pose[2] + turn / 2
        cos, sin = math.cos(middle), math.sin(middle)
        ahead, sideways = linear * period, -self._slide * linear * turn
        self.pose += (ahead * cos - sideways * sin, ahead * sin + sideways * cos, turn)
        motion = np.eye(3)
        motion[:2, 2] = -ahead * sin - sideways * cos, ahead * cos - sideways * sin
        drift = np.array(((cos, -sin, 0), (sin, cos, 0), (0, 0, 1))) * (np.array(SLIP) * period)
        self.covariance = motion @ self.covariance @ motion.T + drift @ drift.T

    def correct(self, points: Array, heights: Array) -> None:
        """Correct by points (m, 2) of obstacles and walls in the robot's frame, m, at these heights (m,)."""
        prior, information = self.pose.copy(), np.linalg.inv(self.covariance)
        (ahead, sideways), walls = points.T, self._corridor.half_width_at(heights)
        gate = GATE + 2 * math.sqrt(self.covariance[1, 1])
        for _ in range(LOOKS):
            _, y, yaw = self.pose
            cos, sin = math.cos(yaw), math.sin(yaw)
            lateral = y + ahead * sin + sideways * cos
            error = np.copysign(walls, lateral) - lateral
            near = np.abs(error) < gate
            slopes = np.column_stack((np.zeros(near.sum()), np.ones(near.sum()), (ahead * cos - sideways * sin)[near]))
            weights = slopes.T / POINT_STD**2
            total = information + weights @ slopes
            step = np.linalg.solve(total, weights @ error[near] + information @ (prior - self.pose))
            self.pose = self.pose + step
        covariance = np.linalg.inv(total)
        covariance[[1, 2], [1, 2]] = np.maximum(covariance[[1, 2], [1, 2]], np.square(MIN_STD))
        self.covariance = covariance

    def in_world(self, points: Array) -> Array:
        """Return points (..., 2) of the robot's frame in the corridor's, m."""
        x, y, yaw = self.pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        ahead, sideways = points[..., 0], points[..., 1]
        return np.stack((x + ahead * cos - sideways * sin, y + ahead * sin + sideways * cos), axis=-1)
