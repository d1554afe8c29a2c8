"""Refuses seeds that are for something else: nobody is judged on episodes that it was made with (`core.seeds`)."""

from typing import Any, Literal

import numpy as np

from armctl.core.errors import ConfigurationError
from armctl.core.seeds import DEVELOPMENT_SEED, TEST_SEED, TRAINING_SEEDS, VALIDATION_SEED

__all__ = [
    "DEVELOPMENT_SEED", "TEST_SEED", "TRAINING_SEEDS", "VALIDATION_SEED", "Seed", "check_training_data_seed",
    "evaluation_seed",
]  # fmt: skip

TEST = "test"
Seed = int | Literal["test"]
"""Seed of an evaluation; `"test"` is the present `TEST_SEED`."""


def evaluation_seed(seed: Seed) -> int:
    """The number of a seed for an evaluation. Raises `ConfigurationError` if its episodes select or train agents."""
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
