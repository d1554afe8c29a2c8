"""Limits of a rover's drives, as they are known at present."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DriveLimits:
    """Limits that can change from one control step to the next, below those of a controller's options."""

    max_speed: float
    """m/s."""
    max_turn_rate: float
    """rad/s."""
    max_acceleration: float
    """m/s^2."""
    max_turn_acceleration: float
    """rad/s^2."""
    margin: float = 0.0
    """m: added to the distance from static obstacles."""
