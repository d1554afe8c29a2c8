"""Statistics of few trainings of one recipe, which say how another training would turn out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from armctl.evaluation.statistics import Estimate, bootstrapped

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrainingMean:
    """A mean over several trainings of one recipe, which all played the same episodes."""

    mean: Estimate
    """Mean over all trainings and episodes; no interval for a single training."""
    trainings: int
    between: float | None
    """Standard deviation between trainings, without the part due to their episodes; None for a single one."""
    episodes: float | None
    """Standard deviation between episodes that is common to all trainings; None for a single one."""


def mean_over_trainings(scores: Array) -> TrainingMean:
    """Mean of scores (trainings, episodes), whose columns are the same episodes.

    The interval is for other trainings and other episodes. Both are random and crossed, with the variance components
    of the analysis of variance (Searle, Casella and McCulloch, Variance Components, 1992, section 4.4) and Student's t
    with one degree of freedom less than trainings. It takes trainings to vary moderately: few of them cannot tell
    whether one in ten fails altogether.
    """
    scores = np.asarray(scores, dtype=float)
    if scores.ndim != 2 or 0 in scores.shape:
        raise ValueError(f"scores must have the shape (trainings, episodes), not {scores.shape}")
    k, n = scores.shape
    value = float(scores.mean())
    if k < 2:
        return TrainingMean(Estimate(value, None, None), k, None, None)
    rows, columns = scores.mean(axis=1, keepdims=True), scores.mean(axis=0, keepdims=True)
    by_training = n * float(np.var(rows, ddof=1))
    by_episode = k * float(np.var(columns, ddof=1)) if n > 1 else 0.0
    rest = float(((scores - rows - columns + value) ** 2).sum()) / ((k - 1) * (n - 1)) if n > 1 else 0.0
    more = max(0.0, by_episode - rest)
    variance = (by_training + more) / (k * n)
    half = variance**0.5 * float(stats.t.ppf(0.975, k - 1))
    between = (max(0.0, by_training - rest) / n) ** 0.5
    return TrainingMean(Estimate(value, value - half, value + half), k, between, (more / k) ** 0.5)


def interquartile_mean(scores: Sequence[Array]) -> Estimate | None:
    """Mean of the middle half of all scores (Agarwal et al. 2021), for scores over trainings.

    Over episodes it would hide failures: with a quarter of them lost, it is still the mean of wins. `scores` are those
    of each training, (k,) each. The percentile bootstrap resamples each separately.
    """
    strata = [np.asarray(one, dtype=float) for one in scores if len(one)]
    if not strata:
        return None

    def statistic(*strata: Array, axis: int = -1) -> Any:
        return stats.trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis)

    return bootstrapped(float(statistic(*strata)), strata, statistic)
