"""Least times to go among people who move: see `armctl.planning.time_to_go`.

Lattices have the points across the bridge first: loops along it are long, and run on vectors.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.kernels.compiling import compiled


class Moves(NamedTuple):
    """Actions at each point: to wait, or to go to another one."""

    wait: float
    """s between two layers."""
    steps: NDArray[np.int64]
    """(k, 2) points across and along the bridge."""
    durations: NDArray[np.float32]
    """(k,) s: so many whole `layers` and a share of one more."""
    layers: NDArray[np.int64]
    shares: NDArray[np.float32]


class People(NamedTuple):
    """People in whose vicinity everything takes longer."""

    positions: NDArray[np.float64]
    """(layers, w, 2) m."""
    reach: float
    """m."""
    slowdown: float
    """Factor of all times within reach."""


class Grid(NamedTuple):
    """Places of the lattice's points, m, and how many points without a place are around them."""

    y: NDArray[np.float64]
    x: NDArray[np.float64]
    pad: int


@compiled
def spread(times, goal, wall, people, grid, moves):
    """Set `times` (layers, ny + 2 pad, nx + 2 pad) from the last layer, which is given, back to the first.

    Where `goal` (ny, nx), times are 0, and at least `wall` (ny, nx).
    """
    wait, steps, durations, layers, shares = moves
    last, ny, nx, pad = len(times) - 1, len(grid.y), len(grid.x), grid.pad
    for k in range(last - 1, -1, -1):
        layer, next_layer = times[k], times[k + 1]
        for i in range(pad, ny + pad):
            for j in range(pad, nx + pad):
                layer[i, j] = wait + next_layer[i, j]
        for e in range(len(steps)):
            first, second = times[min(k + layers[e], last)], times[min(k + layers[e] + 1, last)]
            left, ahead = steps[e, 0] + pad, steps[e, 1] + pad
            for i in range(ny):
                before_share, after_share = first[i + left, ahead : ahead + nx], second[i + left, ahead : ahead + nx]
                improve(layer[i + pad, pad : pad + nx], before_share, after_share, durations[e], shares[e])
        detain(times, k, people, grid, moves)
        for i in range(ny):
            for j in range(nx):
                time = max(layer[i + pad, j + pad], wall[i, j])
                layer[i + pad, j + pad] = 0.0 if goal[i, j] else time


@compiled
def improve(row, first, second, duration, share):
    """Take the times (n,) of a move where they are less; without `min`, which does not run on vectors."""
    for j in range(len(row)):
        time = duration + first[j] + share * (second[j] - first[j])
        if time < row[j]:
            row[j] = time


@compiled
def detain(times, k, people, grid, moves):
    """Set the times of layer `k` at the points within reach of people, where everything takes longer."""
    y, x, pad = grid
    wait, steps, durations, layers, shares = moves
    last, reach, slowdown = len(times) - 1, people.reach, people.slowdown
    for person_x, person_y in people.positions[k]:
        for i in range(len(y)):
            if abs(y[i] - person_y) > reach:
                continue
            for j in range(len(x)):
                if (x[j] - person_x) ** 2 + (y[i] - person_y) ** 2 > reach * reach:
                    continue
                min_time = slowdown * wait + times[k + 1, i + pad, j + pad]
                for e in range(len(steps)):
                    at, to = i + pad + steps[e, 0], j + pad + steps[e, 1]
                    first, second = times[min(k + layers[e], last), at, to], times[min(k + layers[e] + 1, last), at, to]
                    min_time = min(min_time, slowdown * durations[e] + first + shares[e] * (second - first))
                times[k, i + pad, j + pad] = min_time
