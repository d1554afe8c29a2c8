"""Path lengths on a lattice: see `armctl.planning.cost_to_go`."""

import math

import numpy as np

from armctl.kernels.compiling import compiled

PAD = 2
"""Rows and columns of infinite lengths around the lattice, so that edges need no check."""


@compiled
def keep_clear(obstacles, x, y, clearance, free):
    """Set `free` (nx, ny): whether the lattice's points, at `x` (nx,) and `y` (ny,), keep clear of points (k, 2), m."""
    free[:] = True
    spacing_x, spacing_y = x[1] - x[0], y[1] - y[0]
    for k in range(len(obstacles)):
        to_x, to_y = obstacles[k, 0] - x[0], obstacles[k, 1] - y[0]
        low_x = max(math.floor((to_x - clearance) / spacing_x), 0)
        low_y = max(math.floor((to_y - clearance) / spacing_y), 0)
        for i in range(low_x, min(math.ceil((to_x + clearance) / spacing_x) + 1, len(x))):
            dx = x[i] - obstacles[k, 0]
            for j in range(low_y, min(math.ceil((to_y + clearance) / spacing_y) + 1, len(y))):
                dy = y[j] - obstacles[k, 1]
                if math.sqrt(dx * dx + dy * dy) < clearance:
                    free[i, j] = False


@compiled
def spread(lengths, free, steps, edges):
    """Lower `lengths` (nx + 2 PAD, ny + 2 PAD) of free points until each is the least by way of its neighbours.

    `steps` (k, 2) lead to neighbours in other rows, over `edges` (k + 1,) m long; the last edge is that within a row.
    Rows whose neighbours have changed are swept, back and forth: other orders give the same sums.
    """
    nx, ny = free.shape
    stale, previous = np.ones(nx + 2 * PAD, dtype=np.bool_), np.empty(ny)
    backwards = True
    while stale[PAD:-PAD].any():
        for k in range(PAD, nx + PAD):
            i = nx + 2 * PAD - 1 - k if backwards else k
            if stale[i]:
                if relax(lengths, i, free[i - PAD], steps, edges, previous):
                    stale[i - PAD : i + PAD + 1] = True
                stale[i] = False
        backwards = not backwards


@compiled
def relax(lengths, i, free, steps, edges, previous):
    """Lower the lengths of a row; return whether there were any to lower."""
    row = lengths[i, PAD:-PAD]
    previous[:] = row
    for e in range(len(steps)):
        first = PAD + steps[e, 1]
        lower(row, lengths[i + steps[e, 0], first : first + len(row)], edges[e])
    for j in range(len(row)):
        row[j] = row[j] if free[j] else np.inf
    for j in range(1, len(row)):
        if free[j]:
            row[j] = min(row[j], row[j - 1] + edges[-1])
    for j in range(len(row) - 2, -1, -1):
        if free[j]:
            row[j] = min(row[j], row[j + 1] + edges[-1])
    lowered = False
    for j in range(len(row)):
        lowered |= row[j] != previous[j]
    return lowered


@compiled
def lower(row, neighbors, edge):
    """Take the lengths (n,) by way of neighbours where they are less; without `min`, which does not run on vectors."""
    for j in range(len(row)):
        length = neighbors[j] + edge
        if length < row[j]:
            row[j] = length


@compiled
def nearest_distances(obstacles, points, farthest, distances):
    """Compute the `distances` (n,) of points (n, 2) to the nearest of obstacles (k, 2), m; at most `farthest`."""
    x, y = points[:, 0].copy(), points[:, 1].copy()
    low_x, high_x, low_y, high_y = x.min() - farthest, x.max() + farthest, y.min() - farthest, y.max() + farthest
    distances[:] = farthest * farthest
    for k in range(len(obstacles)):
        at_x, at_y = obstacles[k, 0], obstacles[k, 1]
        if low_x <= at_x <= high_x and low_y <= at_y <= high_y:
            for j in range(len(x)):
                dx, dy = x[j] - at_x, y[j] - at_y
                square = dx * dx + dy * dy
                if square < distances[j]:
                    distances[j] = square
    for j in range(len(x)):
        distances[j] = math.sqrt(distances[j])
