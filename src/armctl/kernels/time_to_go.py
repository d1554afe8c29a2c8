"""Least times to go among people who move: see `armctl.planning.time_to_go`.

Lattices have the points across the bridge first. A layer of times is one row of numbers, those of the points around the
lattice among them: loops over it are long, and run on vectors.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.kernels.compiling import compiled


class Moves(NamedTuple):
    """Actions at each point: to wait, or to go to another one. Moves of the same duration follow each other."""

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
    """Places of the lattice's points, m, at equal distances, and how many points without a place are around them."""

    y: NDArray[np.float64]
    x: NDArray[np.float64]
    pad: int


@compiled
def spread(times, bounds, people, grid, moves):
    """Set `times` (layers, ny + 2 pad, nx + 2 pad) from the last layers, which are given, back to the first.

    Given are one layer, and as many after it as the longest move has. Times are kept within `bounds`
    (2, ny + 2 pad, nx + 2 pad), so that those of points without a place stay what they are.
    """
    wait, steps, durations, layers, shares = moves
    flat, size, width = times.ravel(), times[0].size, times.shape[2]
    begin = grid.pad * (width + 1)
    end = size - begin
    low, high = bounds[0].ravel()[begin:end], bounds[1].ravel()[begin:end]
    offsets, arrivals = steps[:, 0] * width + steps[:, 1], np.empty(size, dtype=np.float32)
    jumps = layers * size + offsets
    for k in range(len(times) - 2 - layers.max(), -1, -1):
        current = flat[k * size :]
        layer, next_layer = current[begin:end], current[size:][begin:end]
        for j in range(len(layer)):
            layer[j] = wait + next_layer[j]
        for e in range(len(steps)):
            if e == 0 or durations[e] != durations[e - 1]:
                first = current[layers[e] * size :]
                arrive(arrivals, first, first[size:], durations[e], shares[e])
            improve(layer, arrivals[begin + offsets[e] : end + offsets[e]])
        detain(current, size, jumps, people, people.positions[k], grid, moves)
        keep_within(layer, low, high)


@compiled
def arrive(arrivals, first, second, duration, share):
    """Compute the times (n,) of a move to each point, which ends between two layers."""
    for j in range(len(arrivals)):
        arrivals[j] = duration + first[j] + share * (second[j] - first[j])


@compiled
def improve(layer, arrivals):
    """Take the times (n,) of a move where they are less; without `min`, which does not run on vectors."""
    for j in range(len(layer)):
        if arrivals[j] < layer[j]:
            layer[j] = arrivals[j]


@compiled
def keep_within(layer, low, high):
    """Raise times (n,) to `low`, and lower them to `high`."""
    for j in range(len(layer)):
        time = low[j] if layer[j] < low[j] else layer[j]
        layer[j] = high[j] if time > high[j] else time


@compiled
def detain(times, size, jumps, people, positions, grid, moves):
    """Set the times of a layer of `size` at the points within reach of people, where everything takes longer.

    `times` are those of this layer and later ones, in which moves end `jumps` (k,) numbers after where they begin.
    """
    y, x, pad = grid
    reach, slowdown, width = people.reach, people.slowdown, len(x) + 2 * pad
    for person_x, person_y in positions:
        first_row, after_row = near(y, person_y, reach)
        first_column, after_column = near(x, person_x, reach)
        for i in range(first_row, after_row):
            for j in range(first_column, after_column):
                if (x[j] - person_x) ** 2 + (y[i] - person_y) ** 2 > reach * reach:
                    continue
                point = (i + pad) * width + j + pad
                min_time = slowdown * moves.wait + times[point + size]
                for e in range(len(jumps)):
                    first, second = times[point + jumps[e]], times[point + jumps[e] + size]
                    time = slowdown * moves.durations[e] + first + moves.shares[e] * (second - first)
                    min_time = time if time < min_time else min_time
                times[point] = min_time


@compiled
def near(axis, place, reach):
    """Return the first of the points on an `axis` (n,) that may be within reach of a place, and the first after it."""
    spacing = axis[1] - axis[0]
    first, last = math.floor((place - reach - axis[0]) / spacing), math.ceil((place + reach - axis[0]) / spacing)
    return max(first, 0), min(last + 1, len(axis))
