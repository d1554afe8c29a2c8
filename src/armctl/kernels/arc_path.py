"""A polyline parametrised by arc length: see `armctl.control.ArcPath`.

Segments are rows (k, 5): the arc length (m) and the point (m) where one begins, and its direction. The first and the
last go on straight beyond the ends.
"""

import math

import numpy as np

from armctl.kernels.compiling import compiled, copy_to


@compiled
def point_at(segments, arc):
    """Return the point x, y at an arc length."""
    k = 0
    while k + 1 < len(segments) and segments[k + 1, 0] <= arc:
        k += 1
    length = arc - segments[k, 0]
    return segments[k, 1] + segments[k, 3] * length, segments[k, 2] + segments[k, 4] * length


@compiled
def points_at(segments, arcs, points):
    """Write the `points` (m, 2) at arc lengths (m,)."""
    for i in range(len(arcs)):
        copy_to(point_at(segments, arcs[i]), points[i])


@compiled
def nearest(segments, points, low, high, spacing, arcs):
    """Write into `arcs` (m,) the arc lengths from `low` to `high`, about `spacing` apart, nearest to points (m, 2)."""
    gaps = round((high - low) / spacing)
    along = np.linspace(low, high, gaps + 1)
    places = np.empty((gaps + 1, 2))
    points_at(segments, along, places)
    for i in range(len(points)):
        nearest_square = np.inf
        for k in range(gaps + 1):
            x, y = points[i, 0] - places[k, 0], points[i, 1] - places[k, 1]
            if x * x + y * y < nearest_square:
                nearest_square = x * x + y * y
                arcs[i] = along[k]


@compiled
def rounded(segments, arc, reach):
    """Return the point x, y at an arc length and the direction there; corners are rounded over `reach` both ways."""
    x, y = 0.0, 0.0
    for k in range(-2, 3):
        at_x, at_y = point_at(segments, arc + k * (reach / 2))
        x, y = x + at_x / 5, y + at_y / 5
    (ax, ay), (bx, by) = point_at(segments, arc - reach), point_at(segments, arc + reach)
    length = max(math.hypot(bx - ax, by - ay), 1e-9)
    return x, y, (bx - ax) / length, (by - ay) / length
