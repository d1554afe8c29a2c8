"""What is looked at in all worlds after each tick of the physics."""

import numpy as np

from armctl.kernels.compiling import compiled


@compiled
def mark_unusual(state, columns, lowest, highest, depths, deep, unusual):
    """Mark worlds in which a column of `state` (n, k) is not between its bounds, or contacts are deeper than `deep`, m.

    Bounds are (m,), as `columns` are; `depths` (n,) are those of the deepest contacts, negative. Returns whether any
    is. What is not a number is unusual.
    """
    any_unusual = False
    for world in range(len(state)):
        usual = depths[world] > -deep
        for i in range(len(columns)):
            if not lowest[i] < state[world, columns[i]] < highest[i]:
                usual = False
                break
        unusual[world] = not usual
        any_unusual = any_unusual or not usual
    return any_unusual


@compiled
def clip_speeds(velocities, worlds, dofs, bounds):
    """Clip velocities (n, nv) of `dofs` (k,) to their bounds (k,), in some worlds."""
    for world in worlds:
        for k in range(len(dofs)):
            velocities[world, dofs[k]] = min(max(velocities[world, dofs[k]], -bounds[k]), bounds[k])


@compiled
def note_nearest(positions, targets, nearest):
    """Lower `nearest` (n,) to the distances of positions from targets (n, 3), m, rounded as they are observed."""
    for world in range(len(positions)):
        square = 0.0
        for axis in range(3):
            offset = np.float64(np.float32(targets[world, axis])) - np.float64(np.float32(positions[world, axis]))
            square += offset * offset
        nearest[world] = min(nearest[world], np.sqrt(square))
