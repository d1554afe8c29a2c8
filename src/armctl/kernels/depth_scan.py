"""Reduction of depth images: see `armctl.estimation.depth_scan`."""

import math
from typing import NamedTuple

import numpy as np

from armctl.core.arrays import Array
from armctl.kernels.compiling import compiled

HORIZON, FLOOR = 0.2, (-0.6, -0.12)
"""Rises (m per m ahead) of the rows that see what stands, up or down, and of those that see the floor."""
MIN_DEPTH = 0.05
"""m: less is a lost pixel."""
STANDING = (0.12, 0.76)
"""Heights (m) between which what is seen is an obstacle."""
TALL = (0.9, 1.45)
"""Heights (m) of a person above all obstacles."""
MIN_FLOOR_PIXELS, MIN_TALL_PIXELS = 40, 2


class Rays(NamedTuple):
    """Rays of a camera's pixels."""

    rise: Array
    ahead: Array
    """(height,) per m of depth."""
    sideways: Array
    """(width,) per m of depth."""
    above: float
    """m: height of the camera above the floor."""


class Columns(NamedTuple):
    """Content of the columns: see `DepthScan`. Points begin at the camera."""

    standing: Array
    tall: Array
    heights: Array
    free: Array


@compiled
def tilt(depths, rays, gate):
    """Return the median angle by which the floor is tilted, and that of its pixels' distances from it then, m.

    Pixels of the floor are at most `gate` (m) from where it was expected; of too few, both are NaN.
    """
    heights, slopes, rises = np.empty(depths.size), np.empty(depths.size), np.empty(depths.size)
    angles, count = np.empty(depths.size), 0
    for i in range(len(depths)):
        slope = rays.rise[i] / rays.ahead[i]
        if not FLOOR[0] < slope < FLOOR[1]:
            continue
        to_floor = rays.above / -slope
        for depth in depths[i]:
            height = rays.above + rays.rise[i] * depth
            if depth > MIN_DEPTH and abs(height) < gate:
                heights[count], slopes[count], rises[count] = height, slope, rays.rise[i]
                angles[count] = height / to_floor
                count += 1
    if count < MIN_FLOOR_PIXELS:
        return np.nan, np.nan
    turn = np.median(angles[:count])
    for k in range(count):
        angles[k] = abs((heights[k] + turn * rays.above / slopes[k]) / rises[k])
    return turn, np.median(angles[:count])


@compiled
def reduce(depths, rays, farthest, columns):
    """Compute the content of the `columns` up to a depth of `farthest`, m."""
    rise, ahead, sideways, above = rays
    height, width = depths.shape
    x, y, z = np.empty((2, height)), np.empty((2, height)), np.empty(height)
    for j in range(width):
        standing, tall, is_clear = 0, 0, False
        for i in range(height):
            depth = depths[i, j]
            if depth <= MIN_DEPTH:
                continue
            is_level, is_standing = abs(rise[i] / ahead[i]) < HORIZON, False
            pixel_height = above + depth * rise[i]
            if depth < farthest:
                if is_level and STANDING[0] < pixel_height < STANDING[1]:
                    is_standing = True
                    x[0, standing], y[0, standing], z[standing] = depth * ahead[i], depth * sideways[j], pixel_height
                    standing += 1
                if TALL[0] < pixel_height < TALL[1]:
                    x[1, tall], y[1, tall] = depth * ahead[i], depth * sideways[j]
                    tall += 1
            is_clear = is_clear or (is_level and not is_standing)
        if tall < MIN_TALL_PIXELS:
            tall = 0
        columns.standing[j, 0], columns.standing[j, 1] = median(x[0], standing), median(y[0], standing)
        columns.tall[j, 0], columns.tall[j, 1] = median(x[1], tall), median(y[1], tall)
        columns.heights[j] = median(z, standing)
        columns.free[j] = farthest if is_clear else 0.0
        if standing > 0:
            columns.free[j] = math.sqrt(columns.standing[j, 0] ** 2 + columns.standing[j, 1] ** 2)


@compiled
def median(values, count):
    """Return the median of the first `count` values; NaN if there is none."""
    return np.median(values[:count]) if count > 0 else np.nan
