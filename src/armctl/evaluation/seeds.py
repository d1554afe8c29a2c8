"""Which seeds are for what, so that nobody is judged on episodes that it was made with.

| seeds | episodes |
|---|---|
| 0, 1, ... | development: whatever is tuned, is tuned on these |
| `TEST_SEED` | sealed: published tables and the evaluation on an agent's card; nothing is tuned on it |
| from `VALIDATION_SEED` on | held-out episodes that select the best agent of a training |
| from `TRAINING_SEEDS` on | training; training seed k begins at (k + 1) * `TRAINING_SEEDS` |

No two of them share an episode (see `armctl.disturbances.episode_entropy`).
"""

from typing import Any

import numpy as np

from armctl.errors import ConfigurationError

TEST_SEED = 2026
VALIDATION_SEED = 10**8
TRAINING_SEEDS = 10**9


def check_evaluation_seed(seed: Any) -> None:
    """Raise `ConfigurationError` for a seed whose episodes select or train agents."""
    if isinstance(seed, int | np.integer) and seed >= VALIDATION_SEED:
        use = "training" if seed >= TRAINING_SEEDS else "validation during training"
        raise ConfigurationError(
            f"the episodes of seed {seed} are for {use}: an evaluation takes a seed below {VALIDATION_SEED:,}, such as "
            f"0 for development, or {TEST_SEED} for figures that are published"
        )


def check_training_data_seed(seed: int) -> None:
    """Raise `ConfigurationError` for the test seed: who learns from its episodes knows the test."""
    if seed == TEST_SEED:
        raise ConfigurationError(
            f"the episodes of seed {TEST_SEED} are the sealed test, not for demonstrations: training's seeds begin at "
            f"{TRAINING_SEEDS:,}"
        )
