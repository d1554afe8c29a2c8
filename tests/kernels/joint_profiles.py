"""The law of the drives in NumPy: what `armctl.kernels.drives` is held to."""

from typing import Protocol

import numpy as np

from armctl.core.arrays import Array

TICK = 0.008
"""s: the drives of a UR5 take commands at 125 Hz."""
OVERRUNS = np.linspace(0.0, 1.0, 17)
"""Fractions of the braking distance by which a joint may overrun a position that it passes without stopping."""


class MotionLimits(Protocol):
    """Limits of the drives, (dof,) each: rad, rad/s, rad/s^2."""

    @property
    def lower(self) -> Array: ...
    @property
    def upper(self) -> Array: ...
    @property
    def velocity(self) -> Array: ...
    @property
    def acceleration(self) -> Array: ...


def towards(goal: Array, position: Array, limits: MotionLimits, tick: float = TICK) -> Array:
    """Velocity (..., dof) for the next `tick` (s) on the minimum-time profile from `position` to rest at `goal`."""
    displacement = goal - position
    return np.asarray(np.copysign(_highest_stoppable(np.abs(displacement), limits.acceleration, tick), displacement))


def limited(wanted: Array, position: Array, velocity: Array, limits: MotionLimits) -> Array:
    """The velocity (..., dof) nearest to `wanted` that the limits allow for the next tick.

    It differs from the last tick's `velocity` by no more than the acceleration limit, and the joint can still stop
    before its position limits.
    """
    room = np.minimum(limits.upper - position, position - limits.lower)
    if (room < limits.velocity * (limits.velocity / limits.acceleration + TICK)).any():
        to_upper = _highest_stoppable(np.maximum(limits.upper - position, 0.0), limits.acceleration, TICK)
        to_lower = _highest_stoppable(np.maximum(position - limits.lower, 0.0), limits.acceleration, TICK)
        wanted = np.minimum(np.maximum(wanted, -to_lower), to_upper)
    return limited_without_bounds(wanted, velocity, limits)


def limited_without_bounds(wanted: Array, velocity: Array, limits: MotionLimits) -> Array:
    """`limited` without position limits: for joints far from them, or moving to a goal within them."""
    change = limits.acceleration * TICK
    lowest = np.maximum(velocity - change, -limits.velocity)
    return np.asarray(np.minimum(np.maximum(wanted, lowest), np.minimum(velocity + change, limits.velocity)))


def travel_time(displacement: Array, velocity: Array | float, limits: MotionLimits) -> Array:
    """Minimum time (s) for each joint to move by `displacement` (..., dof), at any final velocity.

    `velocity` (..., dof) is the initial one.
    """
    ahead = np.where(displacement < 0, -velocity, velocity)
    distance, top, acceleration = np.abs(displacement), limits.velocity, limits.acceleration
    run_up = (top**2 - ahead**2) / (2 * acceleration)
    speeding_up = (np.sqrt(ahead**2 + 2 * acceleration * np.minimum(distance, run_up)) - ahead) / acceleration
    return np.asarray(speeding_up + np.maximum(distance - run_up, 0.0) / top)


def max_displacement(times: Array, velocity: Array | float, limits: MotionLimits) -> tuple[Array, Array]:
    """The largest displacement of each joint by `times` (..., 1) s, and its speed then, (..., dof) each.

    `velocity` (..., dof) is the initial one, in the direction of the displacement.
    """
    ramp = np.minimum(times, (limits.velocity - velocity) / limits.acceleration)
    speed = velocity + limits.acceleration * ramp
    return np.asarray((velocity + speed) / 2 * ramp + limits.velocity * (times - ramp)), np.asarray(speed)


def trapezoidal_displacement(times: Array, displacement: Array, limits: MotionLimits) -> Array:
    """Displacement of each joint at `times` (..., 1) s on the trapezoidal profile to `displacement` (..., dof)."""
    distance, acceleration = np.abs(displacement), limits.acceleration
    top = np.minimum(limits.velocity, np.sqrt(acceleration * distance))
    ramp = top / acceleration
    end = 2 * ramp + (distance - top * ramp) / np.maximum(top, 1e-12)
    speeding_up = np.clip(times, 0.0, ramp)
    braking = np.clip(times - (end - ramp), 0.0, ramp)
    cruising = np.clip(times, 0.0, end) - speeding_up - braking
    moved = acceleration * speeding_up**2 / 2 + top * cruising + braking * (top - acceleration * braking / 2)
    return np.asarray(np.copysign(moved, displacement))


def fly_by_setpoint(start: Array, position: Array, time: float, limits: MotionLimits) -> Array:
    """Joint positions (dof,) to command, from rest at `start`, so that all joints are at `position` by `time` (s).

    Joints that would be late if they stopped there overrun it.
    """
    displacement = position - start
    top = np.minimum(limits.velocity, np.sqrt(2 * limits.acceleration * np.abs(displacement)))
    further = displacement + OVERRUNS[:, None] * np.copysign(top**2 / (2 * limits.acceleration), displacement)
    in_time = np.abs(trapezoidal_displacement(np.array(time), further, limits)) >= np.abs(displacement) - 1e-9
    in_time[-1] = True
    least = further[in_time.argmax(axis=0), np.arange(len(displacement))]
    return np.asarray(np.clip(start + least, limits.lower, limits.upper))


def _highest_stoppable(distance: Array, acceleration: Array, tick: float) -> Array:
    """The highest speed for one tick from which a joint, braking at a constant rate, stops at `distance`."""
    unit = acceleration * tick**2
    further_ticks = np.floor((np.sqrt(1 + 8 * distance / unit) - 1) / 2)
    return np.asarray((distance / (further_ticks + 1) + unit * further_ticks / 2) / tick)
