"""Refuses seeds that are for something else: nobody is judged on episodes that it was made with (`armctl.seeds`)."""

from typing import Any

import numpy as np

from armctl.errors import ConfigurationError
from armctl.seeds import TEST_SEED, TRAINING_SEEDS, VALIDATION_SEED

__all__ = ["TEST_SEED", "TRAINING_SEEDS", "VALIDATION_SEED", "check_evaluation_seed", "check_training_data_seed"]


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
