"""Checks of a real arm's measurements: whether they come, are numbers, and are near what was commanded.

Messages are lost and late, and an arm follows set-points with a delay. A measurement is therefore compared with all
positions that were commanded within that delay.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array
from armctl.robot_description import JointLimits

OVERSPEED = 1.1
"""Speed of a joint, relative to its limit, above which something is wrong."""
OVERTRAVEL = 0.02
"""rad beyond a position limit: the same."""


class Watchdog:
    """Finds out that an arm is no longer where it is commanded to be, or that nobody knows.

    `max_age` (s) is the longest time without a new measurement, `following_error` (rad) the largest distance of a joint
    from everything that was commanded within `delay` (s).
    """

    def __init__(
        self, limits: JointLimits, period: float, *, max_age: float, following_error: float, delay: float
    ) -> None:
        self._limits, self._period = limits, period
        self._max_age, self._following_error = max_age, following_error
        self._recent: Array = np.zeros((max(1, round(delay / period)), len(limits.lower)))
        self.restart(np.zeros(len(limits.lower)))

    def restart(self, position: Array) -> None:
        """Begin anew with an arm at rest at `position` (dof,) rad."""
        self.measured: NDArray[np.float64] = np.array(position)
        """(dof,) rad: the latest measurement."""
        self._recent[:] = position
        self._ticks = self._missed = 0
        self._stamp: float | None = None
        self.is_followed = True
        """False if the arm was last measured away from its set-points, or beyond its limits."""

    def commanded(self, position: Array) -> None:
        """Remember a commanded position (dof,) rad."""
        self._recent[self._ticks % len(self._recent)] = position
        self._ticks += 1

    def problem(self, q: ArrayLike | None, qd: ArrayLike | None, stamp: float | None) -> str:
        """Take in a measurement, and return what is wrong; empty if nothing is."""
        position, velocity = finite(q, len(self.measured)), finite(qd, len(self.measured))
        if position is None or velocity is None or (stamp is not None and stamp == self._stamp):
            self._missed += 1
            if self._missed * self._period <= self._max_age:
                return ""
            is_finite = position is not None and velocity is not None
            complaint = (
                "no measurement" if q is None else "no new measurement" if is_finite else "no finite measurement"
            )
            return f"{complaint} for {1000 * self._missed * self._period:.0f} ms"
        self._missed, self._stamp, self.measured = 0, stamp, position
        deviation = self._deviation(position, velocity)
        self.is_followed = not deviation
        return deviation

    def _deviation(self, position: Array, velocity: Array) -> str:
        """Return what an arm does that it should not; empty if there is nothing."""
        beyond = np.maximum(self._recent.min(axis=0) - position, position - self._recent.max(axis=0))
        joint = int(beyond.argmax())
        if beyond[joint] > self._following_error:
            return f"joint {joint + 1} is {beyond[joint]:.2f} rad away from its set-points"
        fast = np.abs(velocity) / self._limits.velocity
        if fast.max() > OVERSPEED:
            return f"joint {int(fast.argmax()) + 1} moves at {fast.max():.1f} times its speed limit"
        return "" if within(self._limits, position) else "a joint is beyond its position limit"


def finite(values: ArrayLike | None, dof: int) -> Array | None:
    """Return `dof` finite numbers as an array; None for anything else."""
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        return None
    return array if array.shape == (dof,) and np.isfinite(array).all() else None


def within(limits: JointLimits, position: Array) -> bool:
    """Return True if a measured position (dof,) is within the limits, but for `OVERTRAVEL`."""
    return bool(((position >= limits.lower - OVERTRAVEL) & (position <= limits.upper + OVERTRAVEL)).all())
