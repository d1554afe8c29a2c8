"""How an arm's drives turn what they are told into motion: one law, for simulator and controllers alike.

Each joint by itself keeps to its velocity and acceleration limits. Told a position, it goes there as soon as it can and
stops. It does so in ticks of constant velocity, which is where drives differ from the textbook's parabola (Han, "From
PID to active disturbance rejection control", IEEE Trans. Industrial Electronics 56, 2009: the time-optimal law in
discrete time).
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TICK = 0.008
"""s: the drives of a UR5 take commands at 125 Hz."""


class MotionLimits(Protocol):
    """What drives keep to, (dof,) each: rad, rad/s, rad/s^2."""

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array


def towards(goal: Array, position: Array, limits: MotionLimits) -> Array:
    """Velocity (..., dof) for the next tick that brings `position` to `goal` the soonest, and stops there."""
    way = goal - position
    return np.asarray(np.copysign(_highest_stoppable(np.abs(way), limits.acceleration), way))


def limited(wanted: Array, position: Array, velocity: Array, limits: MotionLimits) -> Array:
    """The velocity (..., dof) nearest to `wanted` that drives allow for the next tick.

    It differs from the last tick's `velocity` by no more than the acceleration limit, and from it the joint can still
    stop before its position limits.
    """
    to_upper = _highest_stoppable(np.maximum(limits.upper - position, 0.0), limits.acceleration)
    to_lower = _highest_stoppable(np.maximum(position - limits.lower, 0.0), limits.acceleration)
    wanted = np.clip(wanted, -np.minimum(to_lower, limits.velocity), np.minimum(to_upper, limits.velocity))
    change = limits.acceleration * TICK
    return np.asarray(np.clip(wanted, velocity - change, velocity + change))


def travel_time(way: Array, velocity: Array | float, limits: MotionLimits) -> Array:
    """Seconds until each joint can have moved by `way` (..., dof), however fast it then is.

    `velocity` (..., dof) is what it moves with at first.
    """
    ahead = np.where(way < 0, -velocity, velocity)
    distance, top, acceleration = np.abs(way), limits.velocity, limits.acceleration
    run_up = (top**2 - ahead**2) / (2 * acceleration)
    speeding_up = (np.sqrt(ahead**2 + 2 * acceleration * np.minimum(distance, run_up)) - ahead) / acceleration
    return np.asarray(speeding_up + np.maximum(distance - run_up, 0.0) / top)


def _highest_stoppable(distance: Array, acceleration: Array) -> Array:
    """The highest speed for one tick from which a joint can brake to a stop at `distance`."""
    braking = acceleration * (np.sqrt(TICK**2 / 4 + 2 * distance / acceleration) - TICK / 2)
    return np.asarray(np.minimum(braking, distance / TICK))
