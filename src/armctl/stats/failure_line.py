"""The distance at which a policy begins to fail half of the time, along a line of ever stronger disturbances.

Success falls along the line: no stronger disturbance helps. Nothing else is assumed. The estimate is by isotonic
regression (Barlow et al., *Statistical Inference under Order Restrictions*, 1972). The limits are by exact binomial
tests in a fixed sequence: from the mildest point outwards while success is above one half, for the lower limit, and
from the strongest one inwards while it is below, for the upper one. As the hypotheses are nested, only the first true
one that is tested can be rejected wrongly, so that no test needs a correction (Maurer, Hothorn and Lehmacher 1995).
"""

import math

import numpy as np
import scipy
from numpy.typing import ArrayLike

from armctl.core.arrays import Array
from armctl.stats.binomial import clopper_pearson
from armctl.stats.intervals import Estimate

SCALES = (0.6, 0.75, 0.9, 1.0, 1.1, 1.25, 1.5)
"""Factors of the point of a search at which its line is judged."""
HALF = 0.5


def line_through(point: Array) -> Array:
    """Return points (n, d) on the line from no disturbance through a point, ended by the box: each once."""
    points = [(scale * point).clip(max=1.0) for scale in SCALES]
    return np.array([p for i, p in enumerate(points) if i == 0 or not np.array_equal(p, points[i - 1])])


def failure_distance(distances: ArrayLike, successes: ArrayLike, episodes: ArrayLike) -> Estimate:
    """Return the distance from which on at most half of the episodes succeed, with its 95 % interval.

    Distances ascend. The value is infinite if success stays above one half, and so is the upper limit if no point is
    significantly below; the lower limit is 0 if no point is significantly above.
    """
    distance, success, total = (np.asarray(values, dtype=float) for values in (distances, successes, episodes))
    limits = np.array([clopper_pearson(successes=wins, trials=int(n)) for wins, n in zip(success, total, strict=True)])
    above, below = limits[:, 0] > HALF, limits[:, 1] < HALF
    first_not_above = int(np.argmin([*above, False]))
    first_below = len(below) - int(np.argmin([*below[::-1], False]))
    low = float(distance[first_not_above - 1]) if first_not_above else 0.0
    high = float(distance[first_below]) if first_below < len(below) else math.inf
    return Estimate(_crossing(distance, success / total, total), low, high)


def _crossing(distances: Array, rates: Array, episodes: Array) -> float:
    """Return the distance at which the falling regression of success is one half; undisturbed, it is taken as 1."""
    fit = scipy.optimize.isotonic_regression(rates, weights=episodes, increasing=False).x
    if fit[-1] > HALF:
        return math.inf
    first = int(np.argmax(fit <= HALF))
    near, above = (distances[first - 1], fit[first - 1]) if first else (0.0, 1.0)
    share = (above - HALF) / (above - fit[first])
    return float(near + share * (distances[first] - near))
