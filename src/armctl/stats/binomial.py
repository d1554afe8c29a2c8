"""Binomial probabilities. `scipy.stats` has them too, but takes a second to import."""

import numpy as np
import scipy

from armctl.core.arrays import Array

NEGLIGIBLE = 1e-8
"""Probability of the counts that are left out at either end."""


def likely_counts(trials: int, p: float) -> Array:
    """Return the counts of successes whose probability is not negligible."""
    low, rest = (float(quantile(NEGLIGIBLE, np.asarray(float(trials)), share)) + 1 for share in (p, 1 - p))
    return np.arange(low, trials - rest + 1)


def probability(successes: Array, trials: Array | int, p: Array | float) -> Array:
    """Return the probability of so many successes."""
    log_choose = -np.log1p(trials) - scipy.special.betaln(trials - successes + 1, successes + 1)
    logs = scipy.special.xlogy(successes, p) + scipy.special.xlog1py(trials - successes, -p)
    return np.asarray(np.exp(log_choose + logs))


def cdf(successes: Array, trials: Array | int, p: Array | float) -> Array:
    """Return the probability of at most so many successes, from -1 to `trials`."""
    below = scipy.special.betainc(np.maximum(trials - successes, 1), np.maximum(successes, 0) + 1, 1 - p)
    return np.select([successes < 0, successes >= trials], [0.0, 1.0], below)


def quantile(tail: float, trials: Array, p: float) -> Array:
    """Return the most successes that all together have at most the probability `tail`; -1 if there are none."""
    near = np.floor(np.nan_to_num(scipy.special.bdtrik(tail, trials, p), nan=-1.0))
    near = near - (cdf(near, trials, p) > tail)
    return np.asarray(near + (cdf(near + 1, trials, p) <= tail))


def fair_coin_p(heads: int, tosses: int) -> float:
    """Return the exact two-sided p-value for a fair coin; 1 without a toss."""
    fewer = np.asarray(float(min(heads, tosses - heads)))
    return min(1.0, 2 * float(cdf(fewer, tosses, 0.5))) if tosses else 1.0


def clopper_pearson(successes: float, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the exact interval of a probability (Clopper and Pearson 1934)."""
    tail, rest = (1 - confidence) / 2, trials - successes
    low = float(scipy.special.betaincinv(successes, rest + 1, tail)) if successes > 0 else 0.0
    return low, float(scipy.special.betainccinv(successes + 1, rest, tail)) if rest > 0 else 1.0
