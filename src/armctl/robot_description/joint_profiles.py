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
OVERRUNS = np.linspace(0.0, 1.0, 17)
"""Parts of the way to brake that are tried when a joint is to pass a place without standing there."""


class MotionLimits(Protocol):
    """What drives keep to, (dof,) each: rad, rad/s, rad/s^2."""

    @property
    def lower(self) -> Array: ...  # noqa: D102
    @property
    def upper(self) -> Array: ...  # noqa: D102
    @property
    def velocity(self) -> Array: ...  # noqa: D102
    @property
    def acceleration(self) -> Array: ...  # noqa: D102


def towards(goal: Array, position: Array, limits: MotionLimits, tick: float = TICK) -> Array:
    """Velocity (..., dof) for the next tick (s) that brings `position` to `goal` the soonest, and stops there."""
    way = goal - position
    return np.asarray(np.copysign(_highest_stoppable(np.abs(way), limits.acceleration, tick), way))


def limited(wanted: Array, position: Array, velocity: Array, limits: MotionLimits) -> Array:
    """The velocity (..., dof) nearest to `wanted` that drives allow for the next tick.

    It differs from the last tick's `velocity` by no more than the acceleration limit, and from it the joint can still
    stop before its position limits.
    """
    room = np.minimum(limits.upper - position, position - limits.lower)
    if (room < limits.velocity * (limits.velocity / limits.acceleration + TICK)).any():
        to_upper = _highest_stoppable(np.maximum(limits.upper - position, 0.0), limits.acceleration, TICK)
        to_lower = _highest_stoppable(np.maximum(position - limits.lower, 0.0), limits.acceleration, TICK)
        wanted = np.minimum(np.maximum(wanted, -to_lower), to_upper)
    return limited_in_the_open(wanted, velocity, limits)


def limited_in_the_open(wanted: Array, velocity: Array, limits: MotionLimits) -> Array:
    """The same, far from the position limits, or on the way to a goal within them."""
    change = limits.acceleration * TICK
    lowest = np.maximum(velocity - change, -limits.velocity)
    return np.asarray(np.minimum(np.maximum(wanted, lowest), np.minimum(velocity + change, limits.velocity)))


def travel_time(way: Array, velocity: Array | float, limits: MotionLimits) -> Array:
    """Seconds until each joint can have moved by `way` (..., dof), however fast it then is.

    `velocity` (..., dof) is what it moves with at first.
    """
    ahead = np.where(way < 0, -velocity, velocity)
    distance, top, acceleration = np.abs(way), limits.velocity, limits.acceleration
    run_up = (top**2 - ahead**2) / (2 * acceleration)
    speeding_up = (np.sqrt(ahead**2 + 2 * acceleration * np.minimum(distance, run_up)) - ahead) / acceleration
    return np.asarray(speeding_up + np.maximum(distance - run_up, 0.0) / top)


def max_displacement(times: Array, velocity: Array | float, limits: MotionLimits) -> tuple[Array, Array]:
    """How far each joint can have moved at most by `times` (..., 1), s, and how fast it then is, (..., dof) each.

    `velocity` (..., dof) is what it moves with at first, in the direction asked about.
    """
    ramp = np.minimum(times, (limits.velocity - velocity) / limits.acceleration)
    speed = velocity + limits.acceleration * ramp
    return np.asarray((velocity + speed) / 2 * ramp + limits.velocity * (times - ramp)), np.asarray(speed)


def trapezoidal_displacement(times: Array, ways: Array, limits: MotionLimits) -> Array:
    """How far each joint has moved at `times` (..., 1), s, on its `ways` (..., dof) from rest to rest."""
    distance, acceleration = np.abs(ways), limits.acceleration
    top = np.minimum(limits.velocity, np.sqrt(acceleration * distance))
    ramp = top / acceleration
    end = 2 * ramp + (distance - top * ramp) / np.maximum(top, 1e-12)
    speeding_up = np.clip(times, 0.0, ramp)
    braking = np.clip(times - (end - ramp), 0.0, ramp)
    cruising = np.clip(times, 0.0, end) - speeding_up - braking
    moved = acceleration * speeding_up**2 / 2 + top * cruising + braking * (top - acceleration * braking / 2)
    return np.asarray(np.copysign(moved, ways))


def fly_by_setpoint(start: Array, place: Array, time: float, limits: MotionLimits) -> Array:
    """Joint positions (dof,) to command, from rest at `start`, so that all joints are at `place` by `time` (s).

    Those that could not be there by then if they were to stop there, pass it.
    """
    way = place - start
    top = np.minimum(limits.velocity, np.sqrt(2 * limits.acceleration * np.abs(way)))
    further = way + OVERRUNS[:, None] * np.copysign(top**2 / (2 * limits.acceleration), way)
    in_time = np.abs(trapezoidal_displacement(np.array(time), further, limits)) >= np.abs(way) - 1e-9
    in_time[-1] = True
    least = further[in_time.argmax(axis=0), np.arange(len(way))]
    return np.asarray(np.clip(start + least, limits.lower, limits.upper))


def _highest_stoppable(distance: Array, acceleration: Array, tick: float) -> Array:
    """The highest speed for one tick from which a joint can brake, by as much each tick, to a stop at `distance`."""
    unit = acceleration * tick**2
    further_ticks = np.floor((np.sqrt(1 + 8 * distance / unit) - 1) / 2)
    return np.asarray((distance / (further_ticks + 1) + unit * further_ticks / 2) / tick)
