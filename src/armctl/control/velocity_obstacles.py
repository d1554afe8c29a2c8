"""Optimal reciprocal collision avoidance: half-planes of velocities that avoid discs, and the best velocity in them.

van den Berg, Guy, Lin, Manocha: Reciprocal n-body collision avoidance, ISRR 2009 (Springer 2011).
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armctl.core.arrays import Array

SLACKS = (0.0, *(0.05 * 2.0 ** np.arange(10)))
"""m/s by which soft half-planes are relaxed, one after the other, until there is a velocity."""
TOLERANCE = 1e-9


def avoidance(position: Array, velocity: Array, radius: float, horizon: float, period: float) -> tuple[Array, Array]:
    """Return the least change u (2,) m/s of a relative velocity that avoids a disc, and the outward normal (2,) there.

    The disc, of the sum of both radii, is at `position` (2,) m and approached by `velocity` (2,) m/s. Contact is
    avoided for `horizon` s; discs that overlap are apart again after `period` s.
    """
    (x, y), distance = position, math.hypot(*position)
    overlap = distance <= radius
    time = period if overlap else horizon
    offset = velocity - position / time
    along = float(offset @ position)
    length = max(math.hypot(*offset), TOLERANCE)
    if overlap or (along < 0 and along * along > (radius * length) ** 2):  # nearest to the disc at the cone's tip
        normal = offset / length if length > TOLERANCE else -position / max(distance, TOLERANCE)
        return (radius / time - length) * normal, normal
    leg = math.sqrt(distance * distance - radius * radius)
    side = 1.0 if x * offset[1] - y * offset[0] > 0 else -1.0
    direction = np.array((x * leg - side * y * radius, side * x * radius + y * leg)) / distance**2
    return (velocity @ direction) * direction - velocity, side * np.array((-direction[1], direction[0]))


def nearest_velocity(preferred: ArrayLike, normals: Array, bounds: Array, soft: NDArray[np.bool_]) -> Array:
    """Return the velocity (2,) nearest to the `preferred` one in half-planes `normals` (k, 2) @ v >= `bounds` (k,).

    If there is none, the half-planes that are `soft` (k,) are relaxed alike, as far as necessary. Zero
    velocity has to keep to the others.
    """
    preferred = np.asarray(preferred, dtype=float)
    first, second = np.triu_indices(len(bounds), 1)
    (ax, ay), (bx, by) = normals[first].T, normals[second].T
    crossing = np.abs(determinant := ax * by - ay * bx) > TOLERANCE
    for slack in SLACKS:
        relaxed = bounds - slack * soft
        a, b = relaxed[first], relaxed[second]
        corners = np.column_stack((a * by - b * ay, ax * b - bx * a))[crossing] / determinant[crossing, None]
        onto = preferred + (relaxed - normals @ preferred)[:, None] * normals
        candidates = np.vstack((preferred, onto, corners, np.zeros(2)))
        feasible = candidates[(candidates @ normals.T >= relaxed - TOLERANCE).all(axis=1)]
        if len(feasible):
            return np.asarray(feasible[np.linalg.norm(feasible - preferred, axis=1).argmin()])
    return np.zeros(2)
