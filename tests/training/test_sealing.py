"""The guard of all tests of trainings sees who plays the sealed test."""

import pytest

from armctl.core import seeds
from armctl.core.seeds import TEST_SEED
from armctl.envs import make_worlds
from armctl.rl.run import training
from armctl.training.learners import load_learner

from .test_run import RECIPE


def test_it_sees_a_reset():
    worlds = make_worlds("armctl/ArmReach-v0", 2)
    worlds.reset(seed=0)
    for seed in (TEST_SEED, [0, TEST_SEED]):
        with pytest.raises(AssertionError, match="plays the sealed test"):
            worlds.reset(seed=seed)


def test_it_sees_a_training_that_judges_itself_by_it(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "DEVELOPMENT_SEED", TEST_SEED)
    monkeypatch.setattr(seeds, "DEVELOPMENT_SEED", TEST_SEED)
    with pytest.raises(AssertionError, match="plays the sealed test"):
        load_learner("bc")(RECIPE, out=tmp_path / "run", seed=0, progress=False)
