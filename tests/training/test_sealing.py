"""The guard of all tests of trainings sees who plays the sealed test."""

import pytest

from armctl.core.seeds import TEST_SEED
from armctl.envs import make_worlds
from armctl.rollout import evaluate


def test_it_sees_a_reset():
    worlds = make_worlds("armctl/ArmReach-v0", 2)
    worlds.reset(seed=0)
    for seed in (TEST_SEED, [0, TEST_SEED]):
        with pytest.raises(pytest.fail.Exception, match="plays the sealed test"):
            worlds.reset(seed=seed)


def test_it_sees_an_evaluation():
    for seed in ("test", TEST_SEED):
        with pytest.raises(pytest.fail.Exception, match="plays the sealed test"):
            evaluate("random", "armctl/ArmReach-v0", episodes=1, seed=seed, lower_bound_steps=False)
