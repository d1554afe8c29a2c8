"""Dynamic window: the velocities that a robot can reach in a control step, and the arcs that it drives by them.

Fox, Burgard, Thrun: The dynamic window approach to collision avoidance, IEEE Robotics & Automation Magazine 4(1), 1997.
"""

import numpy as np

from armctl.core.arrays import Array


def dynamic_window(velocity: Array, change: Array, limits: Array, samples: int) -> tuple[Array, Array]:
    """Return velocities, linear (k,) m/s and angular (k,) rad/s, of which there are `samples` and 2 `samples` + 1.

    They differ from the present `velocity` (2,) by at most `change` (2,), and are forwards within `limits` (2,).
    """
    lowest = np.array((0.0, -limits[1]))
    low, high = np.clip(velocity - change, lowest, limits), np.clip(velocity + change, lowest, limits)
    linear, angular = np.meshgrid(np.linspace(low[0], high[0], samples), np.linspace(low[1], high[1], 2 * samples + 1))
    return linear.ravel(), angular.ravel()


def arcs(pose: Array, linear: Array, angular: Array, clock: Array) -> tuple[Array, Array]:
    """Return places (k, m, 2) m at the times `clock` (m,) s, evenly spaced, and the headings (k,) rad at the last."""
    period = float(clock[0])
    headings = pose[2] + angular[:, None] * (clock - period / 2)
    steps = period * linear[:, None, None] * np.stack((np.cos(headings), np.sin(headings)), axis=-1)
    return np.asarray(pose[:2] + np.cumsum(steps, axis=1)), pose[2] + angular * clock[-1]
