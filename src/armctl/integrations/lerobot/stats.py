"""The statistics of a LeRobot dataset, by which its learners normalize: of each episode, and of all together.

As in LeRobot's own `compute_stats.py`, the quantiles of a dataset are the means of its episodes' quantiles.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

Stats = Mapping[str, NDArray[np.float64]]
"""`min`, `max`, `mean`, `std` and quantiles (k,), and `count` (1,), the number of frames."""

QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
MAX_PICTURES = 100
"""Largest number of an episode's pictures that statistics are taken of."""
LARGEST_SIDE = 150
"""Pixels of a picture's side that are looked at, or up to twice as many."""


def stats_of(values: NDArray[np.generic]) -> Stats:
    """Statistics of the values (T, k) of an episode."""
    numbers = values.astype(np.float64)
    quantiles = np.quantile(numbers, list(QUANTILES.values()), axis=0)
    return {
        "min": numbers.min(axis=0),
        "max": numbers.max(axis=0),
        "mean": numbers.mean(axis=0),
        "std": numbers.std(axis=0),
        "count": np.array([len(values)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def picture_stats(pictures: NDArray[np.uint8]) -> Stats:
    """Statistics (3, 1, 1) of the colours of an episode's pictures (T, height, width, 3), from 0 to 1."""
    every, stride = -(-len(pictures) // MAX_PICTURES), max(1, max(pictures.shape[1:3]) // LARGEST_SIDE)
    sample = pictures[::every, ::stride, ::stride]
    stats = stats_of(sample.reshape(-1, 3) / 255)
    return {name: value[:, None, None] for name, value in stats.items()} | {"count": np.array([len(sample)])}


def aggregated(episodes: Sequence[Stats]) -> Stats:
    """Statistics of all episodes together."""
    counts = np.concatenate([stats["count"] for stats in episodes])

    def mean(values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        return np.average(values, axis=0, weights=counts)

    means = mean([stats["mean"] for stats in episodes])
    variances = [stats["std"] ** 2 + (stats["mean"] - means) ** 2 for stats in episodes]
    return {
        "min": np.min([stats["min"] for stats in episodes], axis=0),
        "max": np.max([stats["max"] for stats in episodes], axis=0),
        "mean": means,
        "std": np.sqrt(mean(variances)),
        "count": np.array([counts.sum()]),
        **{name: mean([stats[name] for stats in episodes]) for name in QUANTILES},
    }
