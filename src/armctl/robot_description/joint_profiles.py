"""Motion profiles of an arm's drives: one law, for simulator and controllers alike.

Each joint respects its own velocity and acceleration limits. It moves to a commanded position in minimum time and stops
there: a trapezoidal profile, in ticks of constant velocity (Han, "From PID to active disturbance rejection control",
IEEE Trans. Industrial Electronics 56, 2009: the time-optimal law in discrete time). `armctl.kernels.drives` has the
formulas.
"""

import numpy as np
from numpy.typing import ArrayLike

from armctl.core.arrays import Array
from armctl.kernels import drives
from armctl.robot_description.arm import JointLimits

TICK = 0.008
"""s: the drives of a UR5 take commands at 125 Hz."""
FOLLOWING_ERROR = 0.3
"""rad: a command waits for a joint that is so far behind it, because something blocks it; in free motion, none is."""
OVERRUNS = np.linspace(0.0, 1.0, 17)
"""Fractions of the braking distance by which a joint may overrun a position that it passes without stopping."""


def towards(goal: Array, position: Array, limits: JointLimits, tick: float = TICK) -> Array:
    """Return the velocity (dof,) for the next `tick` (s) on the fastest profile from `position` to rest at `goal`."""
    return np.array([
        drives.towards(*ends, acceleration, tick)
        for *ends, acceleration in zip(goal, position, limits.acceleration, strict=True)
    ])  # fmt: skip


def trapezoidal_displacement(times: ArrayLike, displacement: Array, limits: JointLimits) -> Array:
    """Return the displacement (n, dof) at `times` (n,) s on the trapezoidal profiles to `displacement` (dof,)."""
    moved = np.empty((len(np.atleast_1d(times)), len(displacement)))
    drives.profiles(limits.drives, np.ascontiguousarray(times, dtype=float).reshape(-1), displacement, moved)
    return moved


def fly_by_setpoint(start: Array, position: Array, time: float, limits: JointLimits) -> Array:
    """Return joint positions (dof,) to command, from rest at `start`, so that joints are at `position` by `time` (s).

    Joints that would be late if they stopped there overrun it.
    """
    commands = np.empty(len(start))
    drives.fly_by(limits.drives, start, position, time, OVERRUNS, commands)
    return commands
