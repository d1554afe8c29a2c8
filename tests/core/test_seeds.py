from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from typer.testing import CliRunner

import armctl
from armctl.cli import app
from armctl.core import seeds
from armctl.core.errors import ConfigurationError
from armctl.core.seeds import TEST_SEED, TRAINING_SEEDS, VALIDATION_SEED, evaluation_seed
from armctl.datasets.collect import collect
from armctl.disturbances import episode_entropy, episode_rng
from armctl.envs import TaskVectorEnv, episode_seed
from armctl.rl.run.training import Training
from armctl.study import compare, sweep
from armctl.study.reproduce import reproduce
from armctl.tasks import ReachTask
from armctl.training.learners import load_recipe

from .. import command_line

VERBS = {
    "compare": lambda seed, tmp: compare(["random"], episodes=1, seed=seed, out=tmp / "out"),
    "sweep": lambda seed, tmp: sweep(["random"], disturbances=["noise"], episodes=1, seed=seed, out=tmp / "out"),
    "evaluate": lambda seed, tmp: armctl.evaluate("random", episodes=1, seed=seed),
    "suite": lambda seed, tmp: armctl.suite(quick=True, seed=seed, out=tmp / "out"),
    "reproduce": lambda seed, tmp: reproduce("reach_ppo", seed=seed),
}


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("seed", [VALIDATION_SEED, TRAINING_SEEDS - 1, TRAINING_SEEDS, np.int64(3 * 10**9), 2**62])
def test_nobody_is_judged_on_episodes_that_selected_or_trained_agents(verb, seed, tmp_path):
    use = "for training" if seed >= TRAINING_SEEDS else "validation"
    with pytest.raises(ConfigurationError, match=f"seed {seed} are .*{use}.* below 100,000,000"):
        VERBS[verb](seed, tmp_path)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("seed", [0, TEST_SEED, VALIDATION_SEED - 1])
def test_other_seeds_are_for_evaluation(seed):
    assert evaluation_seed(seed) == seed


@pytest.mark.parametrize("seed", ["Test", "", "2026", "0"])
def test_only_the_test_has_a_name(seed):
    with pytest.raises(ConfigurationError, match="a whole number, or 'test'"):
        evaluation_seed(seed)


@pytest.mark.slow
def test_the_sealed_test_goes_by_its_name_everywhere(tmp_path, monkeypatch):
    """Whatever its number is after the next release."""
    monkeypatch.setattr(seeds, "TEST_SEED", 777)
    assert compare(["random"], episodes=1, seed="test", out=tmp_path / "one").seed == 777
    assert sweep(["random"], disturbances={"noise": [0.01]}, episodes=1, seed="test").seed == 777
    first, second = (armctl.evaluate("random", episodes=1, seed=seed) for seed in ("test", 777))
    assert first["return"].equals(second["return"])
    with pytest.raises(ConfigurationError, match="seed 777 are the sealed test"):
        collect("reach_ik", episodes=1, out=tmp_path / "test-v0", seed=777)
    command = ["compare", "random", "--episodes", "1", "--seed", "test", "--out", str(tmp_path / "two")]
    ran = CliRunner().invoke(app, command)
    assert "1 episodes of seed 777" in ran.stdout


@pytest.mark.parametrize("seed", ["-1", "tests", "1.5", ""])
def test_the_command_line_refuses_other_names(seed):
    ran = CliRunner().invoke(app, ["compare", "random", "--seed", seed])
    assert ran.exit_code == 2
    assert "whole number" in ran.stderr


def test_the_command_line_says_so(tmp_path):
    ran = command_line.armctl("compare", "random", "--episodes", "1", "--seed", "1000000000", cwd=tmp_path, check=False)
    assert ran.returncode != 0
    assert "are for training" in " ".join(ran.stderr.split())


def test_no_demonstrations_from_the_test(tmp_path):
    with pytest.raises(ConfigurationError, match="sealed test"):
        collect("reach_ik", episodes=1, out=tmp_path / "test-v0", seed=TEST_SEED)


def test_no_training_plays_the_sealed_test(monkeypatch, tmp_path):
    """It judges itself in development."""
    training = object.__new__(Training)
    training.recipe, training.out = load_recipe("reach_ppo"), tmp_path
    training.options = SimpleNamespace(evaluation_episodes=3)
    played = []
    monkeypatch.setattr("armctl.rl.run.training.DEVELOPMENT_SEED", 4)
    monkeypatch.setattr("armctl.rl.run.training.evaluate", lambda *args, **more: played.append(more["seed"]))
    monkeypatch.setattr("armctl.rl.run.training.evaluation_of", lambda episodes, seed: seed)
    assert (training._final_evaluation(), played) == (4, [4])


@pytest.mark.parametrize("training_seed", [0, 3, 7, 2**32 - 1])
def test_training_begins_beyond_all_other_seeds(training_seed):
    training = object.__new__(Training)
    training.seed = training_seed
    assert training.first_seed() >= TRAINING_SEEDS > VALIDATION_SEED > TEST_SEED


@pytest.mark.parametrize("seed", [0, TEST_SEED, VALIDATION_SEED])
def test_training_beyond_numpys_words_plays_episodes_of_its_own(seed):
    """Training seed 3 gets to 2^32, from where on NumPy cuts seeds into two words."""
    there, here = (2**32 + seed, 0), (seed, 1)
    first, second = (np.random.default_rng(episode_entropy(*one)).random(4) for one in (there, here))
    assert not np.array_equal(first, second)
    assert episode_rng("noise", *there).random() != episode_rng("noise", *here).random()
    assert episode_seed(*there) != episode_seed(*here)


def test_episodes_of_large_seeds_are_their_own():
    worlds = TaskVectorEnv(2, task=ReachTask)
    observations, _ = worlds.reset(seed=[2**32 + TEST_SEED, TEST_SEED], options={"episode": [0, 1]})
    assert not np.array_equal(observations[0], observations[1])


def test_small_seeds_give_the_episodes_that_they_always_gave():
    observations, _ = gymnasium.make("armctl/ArmReach-v0").reset(seed=TEST_SEED)
    task = ReachTask(1, ReachTask.options_type())
    task.reset(np.zeros(1, np.int32), [np.random.default_rng((TEST_SEED, 0))])
    np.testing.assert_array_equal(observations[-3:], task.state.target_position[0].astype(np.float32))
