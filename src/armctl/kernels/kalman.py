"""The arithmetic of `armctl.estimation.kalman`: n Kalman filters of one linear model, of k states and l readings."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.compiling import compiled, copy_to

GROWTH = 4.0
"""Factor by which an innovation may count for more in the noise's identification after each outlier in succession: one
outlier tells of itself, several tell of noise."""


class Beliefs(NamedTuple):
    """States of n filters, changed in place."""

    means: Array
    """(n, k)."""
    covariances: Array
    """(n, k, k)."""
    noise_sums: Array
    """(n, 2): weighted sum of the noise's variances, in units of the model's, and sum of their weights."""
    rejections: NDArray[np.int64]
    """(n,): number of outliers in succession."""


class Tuning(NamedTuple):
    """Numbers of `EstimationOptions`, ready for use."""

    gate: Array
    """(l + 1,): largest squared Mahalanobis distance of an innovation, for each number of readings present."""
    max_rejections: int
    """Outliers in succession after which a filter starts again."""
    forgetting: float
    """Factor of the noise sums at each reading."""
    identifies: bool
    """True if the scale of the noise is identified; it is 1 otherwise."""
    common: bool
    """True if that is the scale of all covariances: it then changes no gain."""
    min_noise: float
    """Least scale of the noise's variance."""


@compiled
def predict(transition, process_noise, shifts, means, covariances):
    """Move n beliefs on by one period, with `shifts` (n, k) of the means by the control input."""
    k = len(transition)
    mean, product = np.empty(k), np.empty((k, k))
    for i in range(len(means)):
        covariance = covariances[i]
        for a in range(k):
            mean[a] = shifts[i, a]
            for b in range(k):
                mean[a] += transition[a, b] * means[i, b]
                product[a, b] = 0.0
                for c in range(k):
                    product[a, b] += transition[a, c] * covariance[c, b]
        for a in range(k):
            means[i, a] = mean[a]
            for b in range(a + 1):  # asymmetry by rounding would grow
                total = process_noise[a, b]
                for c in range(k):
                    total += product[a, c] * transition[b, c]
                covariance[a, b] = covariance[b, a] = total


@compiled
def noise_scale(sums, tuning):
    """Return a filter's noise variance in units of the model's."""
    return max(sums[0] / sums[1], tuning.min_noise) if tuning.identifies else 1.0


@compiled
def learn_noise(innovation, expected, noise, present, limit, sums, tuning):
    """Add an innovation to the sums of noise; `expected` (l, l) is the part of its covariance that is not noise.

    Each variance is squared innovation less the expected part: no more than `limit` times what it was thought to be.
    Where the expected part is large, the innovation tells little, and has little weight.
    """
    scale, variance, doubt, count = noise_scale(sums, tuning), 0.0, 0.0, 0
    for a in range(len(innovation)):
        if present[a]:
            if tuning.common:
                total = expected[a, a] + noise[a, a]
                variance += min(innovation[a] ** 2 / total, limit * scale)
            else:
                largest = limit * (expected[a, a] + scale * noise[a, a])
                variance += (min(innovation[a] ** 2, largest) - expected[a, a]) / noise[a, a]
            doubt += expected[a, a] / noise[a, a]
            count += 1
    weight = 1.0 / (1.0 + doubt / count) ** 2
    sums[0] = tuning.forgetting * sums[0] + weight * variance / count
    sums[1] = tuning.forgetting * sums[1] + weight


@compiled
def update(observation, noise, readings, initial, tuning, beliefs, accepted):
    """Correct n beliefs by `readings` (n, l), whose numbers that are not finite are missing; set `accepted` (n,).

    After more than `max_rejections` in succession, a belief starts again with the covariance `initial` (k, k).
    """
    size, k = observation.shape
    innovation, expected, cross = np.empty(size), np.empty((size, size)), np.empty((size, k))
    present = np.empty(size, dtype=np.bool_)
    for i in range(len(readings)):
        mean, covariance = beliefs.means[i], beliefs.covariances[i]
        count = 0
        for a in range(size):
            present[a] = math.isfinite(readings[i, a])
            count += present[a]
        accepted[i] = count > 0
        if count == 0:
            continue
        for attempt in range(2):
            _innovate(observation, readings[i], mean, covariance, present, innovation, expected, cross)
            scale = noise_scale(beliefs.noise_sums[i], tuning)
            residual, gain = _whiten(innovation, expected, noise, 1.0 if tuning.common else scale, present, cross)
            distance = 0.0
            for a in range(size):
                distance += residual[a] ** 2 / (scale if tuning.common else 1.0)
            if attempt == 0 and tuning.identifies:
                limit = tuning.gate[1] * GROWTH ** beliefs.rejections[i]
                learn_noise(innovation, expected, noise, present, limit, beliefs.noise_sums[i], tuning)
            accepted[i] = distance <= tuning.gate[count]
            if accepted[i]:
                beliefs.rejections[i] = 0
                _correct(mean, covariance, residual, gain)
                break
            beliefs.rejections[i] += 1
            if beliefs.rejections[i] <= tuning.max_rejections:
                break
            for a in range(k):
                copy_to(initial[a], covariance[a])


@compiled
def _innovate(observation, reading, mean, covariance, present, innovation, expected, cross):
    """Compute the innovation (l,), its covariance without noise H P H^T (l, l), and H P (l, k)."""
    size, k = observation.shape
    for a in range(size):
        innovation[a] = 0.0
        for b in range(k):
            cross[a, b] = 0.0
            if present[a]:
                innovation[a] -= observation[a, b] * mean[b]
                for c in range(k):
                    cross[a, b] += observation[a, c] * covariance[c, b]
        if present[a]:
            innovation[a] += reading[a]
    for a in range(size):
        for b in range(size):
            expected[a, b] = 0.0
            if present[a] and present[b]:
                for c in range(k):
                    expected[a, b] += cross[a, c] * observation[b, c]


@compiled
def _whiten(innovation, expected, noise, scale, present, cross):
    """Return L^-1 innovation (l,) and L^-1 H P (l, k), where L L^T = H P H^T + scale R (Cholesky).

    A missing reading is one of no information: a row and a column of the identity.
    """
    size, k = cross.shape
    factor, residual, gain = np.zeros((size, size)), np.empty(size), np.empty((size, k))
    for a in range(size):
        for b in range(a + 1):
            total = expected[a, b] + scale * noise[a, b] if present[a] and present[b] else 0.0
            if a == b and not present[a]:
                total = 1.0
            for c in range(b):
                total -= factor[a, c] * factor[b, c]
            factor[a, b] = math.sqrt(max(total, 1e-300)) if a == b else total / factor[b, b]
        residual[a] = innovation[a]
        for c in range(a):
            residual[a] -= factor[a, c] * residual[c]
        residual[a] /= factor[a, a]
        for b in range(k):
            gain[a, b] = cross[a, b]
            for c in range(a):
                gain[a, b] -= factor[a, c] * gain[c, b]
            gain[a, b] /= factor[a, a]
    return residual, gain


@compiled
def _correct(mean, covariance, residual, gain):
    """Correct a belief by a whitened innovation: mean + W^T residual, covariance - W^T W."""
    size, k = gain.shape
    for a in range(k):
        for c in range(size):
            mean[a] += gain[c, a] * residual[c]
            for b in range(k):
                covariance[a, b] -= gain[c, a] * gain[c, b]
