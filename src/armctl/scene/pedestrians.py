"""Pedestrians who walk on a bridge: where they are at any time."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.errors import ConfigurationError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PedestrianTrajectories:
    """w pedestrians, each walking back and forth on a straight line, and turning at once at its ends.

    Leading axes in front of w are several bridges at once.
    """

    start: Array
    """(..., w, 2), m."""
    end: Array
    """(..., w, 2), m."""
    speed: Array
    """(..., w), m/s."""
    phase: Array
    """Distance along the line there and back at time 0, (..., w), m."""
    radius: float
    """Of a pedestrian, m."""

    def __post_init__(self) -> None:
        shapes = [np.shape(getattr(self, name)) for name in ("speed", "phase", "start", "end")]
        if shapes != [shapes[0], shapes[0], (*shapes[0], 2), (*shapes[0], 2)] or not shapes[0]:
            raise ConfigurationError(f"w pedestrians have arrays of shapes (w,), (w,), (w, 2) and (w, 2), not {shapes}")
        if not 0 <= self.radius < math.inf:
            raise ConfigurationError(f"the radius of a pedestrian is a finite number of m from 0 on, not {self.radius}")

    @property
    def along(self) -> NDArray[np.bool_]:
        """Whether each walks along the bridge, or stands, rather than walks across it, (..., w)."""
        extent = np.abs(self.end - self.start)
        return np.asarray(extent[..., 0] >= extent[..., 1])

    def across(self) -> "PedestrianTrajectories":
        """Those who walk across the bridge, (w,); for one bridge only."""
        who = ~self.along
        return PedestrianTrajectories(self.start[who], self.end[who], self.speed[who], self.phase[who], self.radius)

    def positions(self, times: ArrayLike) -> Array:
        """Where they are at times (...), s: (..., w, 2)."""
        walked, length = self._walked(times)
        share = np.abs(walked - length) / length  # 1 at the start, 0 at the end
        return np.asarray(self.end + (self.start - self.end) * share[..., None])

    def velocities(self, times: ArrayLike) -> Array:
        """How they move at times (...), s: (..., w, 2), m/s."""
        walked, length = self._walked(times)
        speed = np.where(walked < length, self.speed, -self.speed) / length
        return np.asarray(speed[..., None] * (self.end - self.start))

    def _walked(self, times: ArrayLike) -> tuple[Array, Array]:
        """Distance since each was last at the start, (..., w), and the length of the lines, (w,), m."""
        length = np.linalg.norm(self.end - self.start, axis=-1)
        length = np.where(length > 0, length, 1.0)  # a line of length 0: the pedestrian stands, at any phase
        return (self.phase + np.asarray(times, dtype=float)[..., None] * self.speed) % (2 * length), length


NO_PEDESTRIANS = PedestrianTrajectories(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), 0.0)
