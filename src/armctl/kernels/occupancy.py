"""Cells of an occupancy grid: see `armctl.estimation.occupancy_grid`."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.compiling import compiled


class Evidence(NamedTuple):
    """Meaning of what is seen."""

    cell: float
    """m: size of a cell."""
    farthest: float
    """m: farther cells stay as they are."""
    shorter: float
    """m: so far before its end, a ray no longer shows that a cell is free."""
    thickness: float
    """m: so far behind its end, a hit goes on."""
    hit: float
    miss: float
    """Changes of the log-odds."""
    lowest: float
    highest: float
    """Limits of the log-odds."""


class View(NamedTuple):
    """A picture: a fan of rays."""

    x: float
    y: float
    """m: position of the grid's corner, from the observer."""
    ahead: float
    sideways: float
    """Unit vector of the direction from which bearings are counted."""
    edges: Array
    """(m + 1,) tangents of the bearings between the rays, ascending."""
    ranges: Array
    """(m,) m: lengths of the rays."""
    hits: NDArray[np.bool_]
    """(m,) whether an obstacle is at their ends."""


@compiled
def enter(log_odds, evidence, view):
    """Change the log-odds (nx, ny) of the cells that are seen."""
    cell, farthest, edges = evidence.cell, evidence.farthest, view.edges
    nx, ny = log_odds.shape
    for i in range(max(math.floor((-view.x - farthest) / cell), 0), min(math.ceil((farthest - view.x) / cell), nx)):
        x, ray = view.x + cell * (i + 0.5), 0
        for j in range(max(math.floor((-view.y - farthest) / cell), 0), min(math.ceil((farthest - view.y) / cell), ny)):
            y = view.y + cell * (j + 0.5)
            along, across = view.ahead * x + view.sideways * y, view.ahead * y - view.sideways * x
            tangent = across / along
            if along <= 0 or not edges[0] < tangent <= edges[-1]:
                continue
            while tangent <= edges[ray]:
                ray -= 1
            while tangent > edges[ray + 1]:
                ray += 1
            distance = math.sqrt(x * x + y * y)
            beyond = distance - view.ranges[ray]
            if distance >= farthest:
                continue
            if view.hits[ray] and -cell / 2 < beyond < evidence.thickness:
                log_odds[i, j] = min(log_odds[i, j] + evidence.hit, evidence.highest)
            elif beyond < -evidence.shorter:
                log_odds[i, j] = max(log_odds[i, j] + evidence.miss, evidence.lowest)
