"""Purposes of seeds, so that nothing is judged on episodes that it was made with.

| seeds | episodes |
|---|---|
| 0, 1, ... | development: whatever is tuned, is tuned on these |
| `DEVELOPMENT_SEED` | of these, the one by which a training judges its agent, and the trainings to publish are chosen |
| `TEST_SEED` | sealed: published figures only. A release draws it, and plays all published policies on it, once |
| from `VALIDATION_SEED` on | held-out episodes that select the best agent of a training |
| from `TRAINING_SEEDS` on | training; training seed k begins at (k + 1) * `TRAINING_SEEDS` |

No two of them share an episode (see `armctl.disturbances.episode_entropy`).
"""

from typing import Any, Literal

import numpy as np

from armctl.core.errors import ConfigurationError

TEST_SEED = 3381427
DEVELOPMENT_SEED = 2026
VALIDATION_SEED = 10**8
TRAINING_SEEDS = 10**9
TEST = "test"
Seed = int | Literal["test"]
"""Seed of an evaluation; `"test"` is the present `TEST_SEED`."""


def evaluation_seed(seed: Seed) -> int:
    """Return the number of a seed for an evaluation.

    Raises `ConfigurationError` if its episodes select or train agents.
    """
    if isinstance(seed, str):
        if seed != TEST:
            raise ConfigurationError(f"a seed is a whole number, or {TEST!r} for the sealed test, not {seed!r}")
        return TEST_SEED
    if isinstance(seed, int | np.integer) and seed >= VALIDATION_SEED:
        use = "training" if seed >= TRAINING_SEEDS else "validation during training"
        raise ConfigurationError(
            f"the episodes of seed {seed} are for {use}: an evaluation takes a seed below {VALIDATION_SEED:,}, such as "
            f"0 for development, or {TEST!r} for figures that are published"
        )
    return seed


def check_training_data_seed(seed: Any) -> None:
    """Raise `ConfigurationError` for the test seed: who learns from its episodes knows the test."""
    if seed in (TEST, TEST_SEED):
        raise ConfigurationError(
            f"the episodes of seed {TEST_SEED} are the sealed test, not for demonstrations: training's seeds begin at "
            f"{TRAINING_SEEDS:,}"
        )
