"""Distances of end-effectors from their targets, and angles between their orientations."""

import numpy as np

from armctl.kernels.compiling import compiled


@compiled
def distance_as_observed(position, target):
    """Return the distance (m) of a position from a target (3,), rounded as in observations."""
    square = 0.0
    for axis in range(3):
        offset = np.float64(np.float32(target[axis])) - np.float64(np.float32(position[axis]))
        square += offset * offset
    return np.sqrt(square)


@compiled
def distances_as_observed(positions, targets, distances):
    """Compute `distances` (n,) of n positions from targets, (n, 3) each, rounded as in observations."""
    for i in range(len(distances)):
        distances[i] = distance_as_observed(positions[i], targets[i])


@compiled
def angle_between(rotation, target):
    """Return the angle (rad) between two rotation matrices (9,)."""
    square = 0.0
    for i in range(9):
        square += (target[i] - rotation[i]) ** 2
    return 2 * np.arcsin(min(1.0, np.sqrt(square / 8)))


@compiled
def angles_between(rotations, targets, angles):
    """Compute the `angles` (n,) between rotation matrices (n, 9), rad."""
    for i in range(len(angles)):
        angles[i] = angle_between(rotations[i], targets[i])
