"""Trajectories of pedestrians on a bridge."""

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError


def turned_back(y: Any, turn: float) -> Any:
    """Return where people are who walk across a bridge and turn back `turn` m from its middle each time.

    `y` (m), an array or a tensor, is where they would be if they walked on straight.
    """
    walked = y + turn
    there_and_back = walked - 4 * turn * (walked // (4 * turn))
    return turn - abs(there_and_back - 2 * turn)


@dataclass(frozen=True, eq=False)
class PedestrianTrajectories:
    """w pedestrians, each walking back and forth on a straight line without pausing at its ends.

    Axes before w stand for several bridges.
    """

    start: Array
    """(..., w, 2) m"""
    end: Array
    """(..., w, 2), m."""
    speed: Array
    """(..., w), m/s."""
    phase: Array
    """(..., w) m: distance walked since the start, there and back, at time 0"""
    radius: float
    """m: radius of each pedestrian"""

    def __post_init__(self) -> None:
        shapes = [np.shape(getattr(self, name)) for name in ("speed", "phase", "start", "end")]
        if shapes != [shapes[0], shapes[0], (*shapes[0], 2), (*shapes[0], 2)] or not shapes[0]:
            raise ConfigurationError(
                f"pedestrians should have arrays of shapes (w,), (w,), (w, 2) and (w, 2), not {shapes}"
            )
        if not 0 <= self.radius < math.inf:
            raise ConfigurationError(f"radius should be a finite number of at least 0 m, not {self.radius}")

    @property
    def along(self) -> NDArray[np.bool_]:
        """(..., w) True for pedestrians who walk along the bridge or stand, rather than walk across it."""
        extent = np.abs(self.end - self.start)
        return np.asarray(extent[..., 0] >= extent[..., 1])

    @property
    def arrays(self) -> dict[str, Array]:
        """All arrays, by name."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "radius"}

    @property
    def lanes(self) -> Array:
        """(..., w, 4) m: both ends of the lines."""
        return np.concatenate((self.start, self.end), axis=-1)

    def moved_to(self, start: Array, end: Array) -> "PedestrianTrajectories":
        """Return the same with lines between other ends (..., w, 2), m."""
        return replace(self, start=start, end=end)

    def across(self) -> "PedestrianTrajectories":
        """Return those who walk across the bridge; for one bridge only."""
        who = ~self.along
        return PedestrianTrajectories(self.start[who], self.end[who], self.speed[who], self.phase[who], self.radius)

    def positions(self, times: ArrayLike) -> Array:
        """Return positions (..., w, 2) m at times (...) s."""
        return self.positions_of_each(np.asarray(times, dtype=float)[..., None])

    def velocities(self, times: ArrayLike) -> Array:
        """Return velocities (..., w, 2) m/s at times (...) s."""
        return self.velocities_of_each(np.asarray(times, dtype=float)[..., None])

    def positions_of_each(self, times: Array) -> Array:
        """Return positions (..., w, 2) m, of each pedestrian at a time of its own, (..., w) s."""
        walked, length = self._walked(times)
        share = np.abs(walked - length) / length  # 1 at the start, 0 at the end
        return np.asarray(self.end + (self.start - self.end) * share[..., None])

    def velocities_of_each(self, times: Array) -> Array:
        """Return velocities (..., w, 2) m/s, of each pedestrian at a time of its own, (..., w) s."""
        walked, length = self._walked(times)
        speed = np.where(walked < length, self.speed, -self.speed) / length
        return np.asarray(speed[..., None] * (self.end - self.start))

    def _walked(self, times: Array) -> tuple[Array, Array]:
        """Return the distance (..., w) m since each left the start, and the lengths (w,) m of the lines."""
        length = np.linalg.norm(self.end - self.start, axis=-1)
        length = np.where(length > 0, length, 1.0)  # on a line of length 0 the pedestrian stands
        return (self.phase + times * self.speed) % (2 * length), length


NO_PEDESTRIANS = PedestrianTrajectories(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0), 0.0)
