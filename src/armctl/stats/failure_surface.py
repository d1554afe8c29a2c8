"""The mildest point of a box of disturbances at which a policy fails half of the time, from single episodes.

A logistic response surface: the logarithmic odds of success are a quadratic polynomial that no disturbance raises, so
that all of its coefficients but the constant fall. The mildest point of its level set at one half is the *design point*
of structural reliability, which such surfaces approach in a few rounds, each in a smaller box around the last point
(Bucher and Bourgund, "A fast and efficient response surface approach for structural reliability problems", Structural
Safety 7, 1990). Each episode has a point of its own, so that none is spent on repeats.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from armctl.core.arrays import Array

ROUND_WIDTHS = (1.0, 0.35, 0.2, 0.12, 0.08)
"""Half widths of the boxes of all rounds, in units of each range."""
FIRST_SHARE = 0.3
"""Share of the episodes that the first round plays, in the whole box."""
PRIOR_MEAN, PRIOR_SCALE, SLOPE_SCALE = 2.0, 4.0, 8.0
"""Normal prior of the undisturbed logarithmic odds, and scale of that of the slopes: weak, but with a maximum even
where all episodes succeed."""
DIRECTIONS, SPARSE_DIRECTIONS = 2048, 200
"""Directions that are searched for the mildest point: of all disturbances, and of each set of them."""


@dataclass(frozen=True)
class FailureSurface:
    """Logarithmic odds of success: `constant` - `slopes` x - x `curvature` x."""

    constant: float
    slopes: Array
    """(d,) at least 0."""
    curvature: Array
    """(d, d) upper triangular, at least 0."""

    def success(self, points: Array) -> Array:
        """Return the probability of success at points (n, d)."""
        quadratic = np.einsum("ni,ij,nj->n", points, self.curvature, points)
        return np.asarray(scipy.special.expit(self.constant - points @ self.slopes - quadratic))

    def mildest(self, whole: Mapping[int, Array]) -> Array | None:
        """Return the point of least norm in the unit box at which success is at most one half; None without any.

        Coordinates in `whole` have these values only.
        """
        free = [i for i in range(len(self.slopes)) if i not in whole]
        best = None
        for values in itertools.product(*whole.values()):
            fixed = np.zeros(len(self.slopes))
            fixed[list(whole)] = values
            points = self._level_set(fixed, free)
            if len(points):
                point = points[np.linalg.norm(points, axis=1).argmin()]
                best = point if best is None or np.linalg.norm(point) < np.linalg.norm(best) else best
        return best

    def _level_set(self, fixed: Array, free: Sequence[int]) -> Array:
        """Return the points of the box at which success falls to one half, on rays from `fixed` on."""
        rays = np.zeros((len(unit := _directions(len(free))), len(fixed)))
        rays[:, free] = unit
        odds = self.constant - self.slopes @ fixed - fixed @ self.curvature @ fixed
        slope = rays @ (self.slopes + (self.curvature + self.curvature.T) @ fixed)
        bend = np.einsum("ni,ij,nj->n", rays, self.curvature, rays)
        if odds <= 0:
            return fixed[None]
        root = np.sqrt(slope**2 + 4 * bend * odds)
        falls = slope + root > 0
        points = fixed + (2 * odds / (slope + root)[falls])[:, None] * rays[falls]
        return np.asarray(points[(points <= 1 + 1e-9).all(axis=1)].clip(0.0, 1.0))


def fitted_surface(points: Array, success: NDArray[np.bool_]) -> FailureSurface:
    """Return the surface of the highest posterior probability, from single episodes at points (n, d)."""
    dimension = points.shape[1]
    products = list(itertools.combinations_with_replacement(range(dimension), 2))
    features = np.hstack([points, np.stack([points[:, i] * points[:, j] for i, j in products], axis=1)])

    def loss(parameters: Array) -> tuple[float, Array]:
        odds = parameters[0] - features @ parameters[1:]
        error = scipy.special.expit(odds) - success
        away = (parameters[0] - PRIOR_MEAN) / PRIOR_SCALE
        slopes = parameters[1:] / SLOPE_SCALE
        value = np.logaddexp(0.0, np.where(success, -odds, odds)).sum() + 0.5 * (away**2 + slopes @ slopes)
        gradient = np.concatenate([[error.sum() + away / PRIOR_SCALE], slopes / SLOPE_SCALE - features.T @ error])
        return float(value), gradient

    count = features.shape[1]
    bounds = [(None, None), *[(0.0, None)] * count]
    start = np.concatenate([[PRIOR_MEAN], np.ones(count)])
    best = scipy.optimize.minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds).x
    curvature = np.zeros((dimension, dimension))
    curvature[tuple(zip(*products, strict=True))] = best[1 + dimension :]
    return FailureSurface(float(best[0]), best[1 : 1 + dimension], curvature)


def round_sizes(budget: int) -> list[int]:
    """Return the number of episodes of each round."""
    later = round((1 - FIRST_SHARE) * budget) // (len(ROUND_WIDTHS) - 1)
    return [budget - later * (len(ROUND_WIDTHS) - 1), *[later] * (len(ROUND_WIDTHS) - 1)]


def round_box(center: Array, number: int) -> tuple[Array, Array]:
    """Return the lowest and highest point of a round's box around the last point; the first one is the whole box."""
    width = ROUND_WIDTHS[number]
    return np.clip(center - width, 0.0, 1.0), np.clip(center + width, 0.0, 1.0)


def _directions(dimension: int) -> Array:
    """Return unit vectors (n, dimension) of the positive orthant, also of those in which only some coordinates change.

    Without a coordinate, that is one empty vector.
    """
    if dimension == 0:
        return np.zeros((1, 0))
    rng = np.random.default_rng(0)
    parts = [np.eye(dimension), np.abs(rng.standard_normal((DIRECTIONS, dimension)))]
    masks = itertools.product((0.0, 1.0), repeat=dimension)
    parts += [
        np.abs(rng.standard_normal((SPARSE_DIRECTIONS, dimension))) * mask
        for mask in masks
        if 1 < sum(mask) < dimension
    ]
    rays = np.vstack(parts)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
