"""Capitals of gamblers who bet on the mean of values: see `armctl.stats.sequential`."""

import math

import numpy as np

from armctl.kernels.compiling import compiled

TOGETHER = 24
"""Values after which logarithms are taken: a product of so many growths, below 1e12 each for means from 1e-12 on, is a
number."""


@compiled
def largest_capital(bets, log_weights, values, mean):
    """Return the logarithm of the largest capital, at any time, of a gambler who bets that values are above a `mean`.

    It begins with a mixture of `bets` (m,) with the logarithms of their weights. `values` (k,) are from 0 to 1.
    """
    capitals, largest = log_weights.copy(), -np.inf
    shares, growths = np.empty(len(bets)), np.empty(len(bets))
    for start in range(0, len(values), TOGETHER):
        top, best = capitals.max(), 0.0
        for i in range(len(bets)):
            shares[i], growths[i] = math.exp(capitals[i] - top), 1.0
        for value in values[start : start + TOGETHER]:
            odds, total = value / mean - 1.0, 0.0
            for i in range(len(bets)):
                growths[i] *= 1.0 + bets[i] * odds
                total += shares[i] * growths[i]
            best = max(best, total)
        largest = max(largest, top + math.log(best))
        for i in range(len(bets)):
            capitals[i] += math.log(growths[i])
    return largest
