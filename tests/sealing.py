"""A guard for all tests of trainings and tunings: none of them plays the sealed test."""

import numpy as np
import pytest

from armctl.core.seeds import TEST_SEED
from armctl.envs import EpisodeVectorEnv


@pytest.fixture(autouse=True)
def sealed(monkeypatch):
    """Fails where an episode of the sealed test begins."""
    begin = EpisodeVectorEnv.reset

    def reset(self, *, seed=None, options=None):
        if np.any(np.asarray(-1 if seed is None else seed) == TEST_SEED):
            pytest.fail("this plays the sealed test")  # which nothing takes for an environment's failure
        return begin(self, seed=seed, options=options)

    monkeypatch.setattr(EpisodeVectorEnv, "reset", reset)
