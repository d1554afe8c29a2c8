import csv
import dataclasses
import json
import sys
from types import SimpleNamespace

import joblib
import numpy as np
import pytest
import torch

from armctl.agents import load_agent
from armctl.core.errors import ConfigurationError
from armctl.core.seeds import VALIDATION_SEED
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.rl.algorithms.ppo import PpoOptions
from armctl.rl.networks.actor import Actor
from armctl.rl.run import training as module
from armctl.rl.run.options import TrainingOptions
from armctl.rl.run.threads import MAX_THREADS
from armctl.rl.run.training import Training, bar_fits
from armctl.rollout.loop import rollouts
from armctl.tasks import ReachTask
from armctl.training.learners import load_recipe

OPTIONS = TrainingOptions(worlds=2, validation_episodes=4, evaluation_episodes=3, evaluation_every=100)


def recipe(**changes):
    return load_recipe("reach_ppo").changed(**{"shaping": None, **changes})


def start(recipe, options, out):
    with Training(recipe, options, out, 0, False):
        pass


class Constant(torch.nn.Module):
    """A network that has learnt one action."""

    def __init__(self, value):
        super().__init__()
        self.value = torch.nn.Parameter(torch.tensor(value))

    def forward(self, observation):
        return self.value.expand(observation.shape[0], 6)


def constant_actor(training, value):
    return Actor(Constant(value), training.view.action_scale, training.held_out.single_observation_space)


@pytest.fixture
def graded(monkeypatch):
    """Held-out episodes, of which an actor wins the share that its network says, with return 10 if that is below 0."""

    def play(actor, worlds, episodes, seed, name, lower_bound_steps):
        value = actor.network.value.item()
        for k in range(episodes):
            yield SimpleNamespace(success=k < value * episodes, total_reward=10.0 if value < 0 else 1.0)

    monkeypatch.setattr(module, "rollouts", play)


@pytest.mark.slow
def test_the_best_is_kept_and_exported(tmp_path, graded):
    rows = []
    with Training(recipe(), OPTIONS, tmp_path / "run", 0, False, rows.append) as training:
        for steps, value in enumerate((0.25, 0.75, 0.5, 0.0)):
            training.evaluate(constant_actor(training, value), steps)
            assert rows == training.curve(), "who is called finds the row in the file, too"
        card = training.finish(constant_actor(training, 0.25), 5)
    assert (card.best_after, card.training_steps) == (1, 5)
    worlds = TaskVectorEnv(3, task=ReachTask)
    observations, _ = worlds.reset(seed=0)
    moves = load_agent(tmp_path / "run" / "agent.json", worlds).act(observations) - observations[:, 3:9]
    np.testing.assert_allclose(moves, 0.5 * 0.75, atol=1e-6)


def test_of_equal_success_the_higher_return_is_better(tmp_path, graded, unexported):
    with Training(recipe(), OPTIONS, tmp_path / "run", 0, False) as training:
        for steps, value in enumerate((0.0, -1.0, 0.0)):
            training.evaluate(constant_actor(training, value), steps)
        assert training.finish(constant_actor(training, 0.0), 3).best_after == 1


def test_the_last_is_kept_if_the_options_say_so(tmp_path, graded, unexported):
    with Training(recipe(), dataclasses.replace(OPTIONS, keeps="last"), tmp_path / "run", 0, False) as training:
        for steps, value in enumerate((0.75, 0.25)):
            training.evaluate(constant_actor(training, value), steps)
        assert training.finish(constant_actor(training, 0.0), 1).best_after == 1


def test_curve_and_best_survive_a_resumption(tmp_path, graded, unexported):
    out = tmp_path / "run"
    with Training(recipe(), OPTIONS, out, 0, False) as training:
        for steps, value in ((0, 0.25), (100, 0.75)):
            training.evaluate(constant_actor(training, value), steps)
        training.checkpoint(150, lambda path: path.write_text("a model"))
        before = training.meter.seconds
    with Training(recipe(), OPTIONS, out, 0, True) as training:
        assert training.newest_checkpoint() == out / "checkpoints" / "150.zip"
        assert training.meter.seconds > 0.9 * before
        assert not training.due(199)
        assert training.due(200)
        training.evaluate(constant_actor(training, 0.5), 200)
        training.evaluate(constant_actor(training, 1.0), 200)  # nothing new after as many steps
        assert [row["steps"] for row in training.curve()] == [0, 100, 200]
        assert [row["success"] for row in training.curve()] == [0.25, 0.75, 0.5]
        assert training.finish(constant_actor(training, 0.0), 250).best_after == 100


def test_the_curve_is_a_table_of_held_out_episodes(tmp_path):
    out = tmp_path / "run"
    with Training(recipe(), OPTIONS, out, 0, False) as training:
        actor = constant_actor(training, 0.1)
        training.evaluate(actor, 0)
    with (out / "curve.csv").open() as lines:
        (row,) = csv.DictReader(lines)
    columns = "steps,minutes,success,low,high,return,decisions,processor_seconds,contacts,interventions"
    assert list(row) == columns.split(",")
    worlds = make_worlds("armctl/ArmReach-v0", 4)
    played = list(rollouts(actor, worlds, 4, VALIDATION_SEED))
    assert float(row["return"]) == pytest.approx(np.mean([episode.total_reward for episode in played]))
    assert float(row["low"]) <= float(row["success"]) <= float(row["high"])
    assert list((out / "tensorboard").glob("events*"))


def test_a_half_written_checkpoint_is_none(tmp_path):
    out = tmp_path / "run"
    with Training(recipe(), OPTIONS, out, 0, False) as training:
        assert training.newest_checkpoint() is None
        training.checkpoint(90, lambda path: path.write_text("older"))
        training.checkpoint(1000, lambda path: path.write_text("newer"))
        with pytest.raises(KeyboardInterrupt):
            training.checkpoint(2000, half)
        assert training.newest_checkpoint().name == "1000.zip"


def half(path):
    path.write_text("half")
    raise KeyboardInterrupt


def test_training_plays_other_episodes_than_any_evaluation(tmp_path):
    with Training(recipe(), OPTIONS, tmp_path / "run", 2, False) as training:
        assert training.first_seed() == 3 * 10**9
        assert training.first_seed(500) == 3 * 10**9 + 500


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"name": "another"}, "name 'reach_ppo', not 'another'"),
        ({"learner": "sac"}, "learner 'ppo', not 'sac'"),
        ({"shaping": "distance"}, "shaping None, not 'distance'"),
        ({"env_options": {"robot": "ur10"}}, r"env_options \{\}, not \{'robot': 'ur10'\}"),
        ({"reward_weights": {"goal": 0.5}}, "reward_weights"),
        ({"training_options": {"disturbances": {"noise": [0, 0.1]}}}, "training_options"),
        ({"teacher": "reach_ik"}, "teacher None, not 'reach_ik'"),
    ],
)
def test_a_training_resumes_with_its_own_recipe_only(tmp_path, changes, says):
    out = tmp_path / "run"
    start(recipe(), OPTIONS, out)
    with pytest.raises(ConfigurationError, match=says):
        Training(recipe(**changes), OPTIONS, out, 0, True)
    with pytest.raises(ConfigurationError, match="seed 0, not 1"):
        Training(recipe(), OPTIONS, out, 1, True)
    with pytest.raises(ConfigurationError, match=r"gamma 0.97, not 0.5"):
        Training(recipe(), dataclasses.replace(OPTIONS, gamma=0.5), out, 0, True)
    Training(recipe(), dataclasses.replace(OPTIONS, steps=10**9), out, 0, True)


def test_a_used_folder_is_not_overwritten(tmp_path):
    start(recipe(), OPTIONS, tmp_path / "run")
    with pytest.raises(ConfigurationError, match="--resume"):
        Training(recipe(), OPTIONS, tmp_path / "run", 0, False)
    with pytest.raises(ConfigurationError, match="no training to resume"):
        Training(recipe(), OPTIONS, tmp_path / "other", 0, True)


def test_spoilt_settings_are_named(tmp_path):
    start(recipe(), OPTIONS, tmp_path / "run")
    other = json.loads((tmp_path / "run" / "settings.json").read_text()) | {"format": 2}
    for text, says in (
        ("", "is damaged"),
        ("[]", "is damaged"),
        ('{"seed": 0}', "no format number"),
        ('{"format": 1, "seed": 0}', "is damaged"),
        (json.dumps(other), "it has format 2; armctl .* reads format 1"),
    ):
        (tmp_path / "run" / "settings.json").write_text(text)
        with pytest.raises(ConfigurationError, match=rf"settings\.json .*{says}"):
            Training(recipe(), OPTIONS, tmp_path / "run", 0, True)


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    for out in (tmp_path / "file" / "run", tmp_path / "file"):
        with pytest.raises(ConfigurationError, match="cannot be written"):
            Training(recipe(), OPTIONS, out, 0, False)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"env_options": {"control": "nope"}}, "control"),
        ({"env_options": {"robto": "ur3"}}, "Did you mean 'robot'"),
        ({"env_options": {"num_envs": 3}}, "num_envs"),
        ({"env": "CartPole-v1"}, "not made of a task"),
        ({"env": "armctl/Nothing-v0"}, "no environment"),
        ({"reward_weights": {"gaol": 1.0}}, "Did you mean 'goal'"),
        ({"training_options": {"disturbances": {"noize": [0, 0.1]}}}, "Did you mean 'noise'"),
        ({"training_options": {"disturbances": {"noise": [0.1, 0]}}}, "from the lowest to the highest"),
        ({"shaping": "distanc"}, "Did you mean 'distance'"),
        ({"shaping": "ompl"}, "ompl"),
    ],
)
def test_a_recipe_that_cannot_be_followed_leaves_no_folder(tmp_path, changes, says):
    with pytest.raises(ConfigurationError, match=says):
        Training(recipe(**changes), OPTIONS, tmp_path / "run", 0, False)
    assert not (tmp_path / "run").exists()


def test_training_options_hold_in_training_only(tmp_path, graded, unexported):
    env_options = {"tolerance": 0.1, "max_episode_steps": 30}
    changed = recipe(env_options=env_options, training_options={"tolerance": 0.2, "disturbances": {"noise": [0, 0.01]}})
    with Training(changed, OPTIONS, tmp_path / "run", 0, False) as training:
        trained = training.envs.unwrapped
        assert (trained.task.options.tolerance, training.held_out.task.options.tolerance) == (0.2, 0.1)
        assert (trained.max_episode_steps, training.held_out.max_episode_steps) == (30, 30)
        assert trained.disturbances
        assert not training.held_out.disturbances
        training.evaluate(constant_actor(training, 0.25), 0)
        card = training.finish(constant_actor(training, 0.25), 1)
    assert (card.env_options, card.training_options) == (env_options, changed.training_options)
    with pytest.raises(ConfigurationError, match="training_options"):
        Training(recipe(env_options=env_options), OPTIONS, tmp_path / "run", 0, True)


@pytest.mark.parametrize("option", [{"actions": "normalized"}, {"observation": "full"}, {"robot": "ur10"}])
def test_training_options_change_nothing_that_an_agent_depends_on(tmp_path, option):
    with pytest.raises(ConfigurationError, match="belongs in env_options"):
        Training(recipe(training_options=option), OPTIONS, tmp_path / "run", 0, False)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_a_seed_out_of_range(tmp_path, seed):
    with pytest.raises(ConfigurationError, match="training seed"):
        Training(recipe(), OPTIONS, tmp_path / "run", seed, False)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"stepps": 1}, "Did you mean 'steps'"),
        ({"steps": 0}, "steps: .*greater than or equal to 1, not 0"),
        ({"steps": "many"}, "steps: .*integer, not 'many'"),
        ({"steps": 1.5}, "steps"),
        ({"worlds": True}, "worlds"),
        ({"gamma": 1.1}, "gamma"),
        ({"gamma": float("nan")}, "gamma"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"learning_rate": float("inf")}, "learning_rate"),
        ({"features": "no"}, "features"),
    ],
)
def test_options_are_checked(options, says):
    with pytest.raises(ConfigurationError, match=says):
        recipe(options=options).read_options(PpoOptions)


def test_settings_tell_all_that_was_told(tmp_path):
    shown = recipe(options={"steps": 7, "gamma": 1}, env_options={"tolerance": 0.1})
    options = shown.read_options(PpoOptions)
    with Training(shown, options, tmp_path / "run", 4, False):
        pass
    settings = json.loads((tmp_path / "run" / "settings.json").read_text())
    assert settings["seed"] == 4
    assert settings["env_options"] == {"tolerance": 0.1}
    assert settings["options"] == dataclasses.asdict(options)


def test_making_a_training_makes_no_folder(tmp_path):
    training = Training(recipe(), OPTIONS, tmp_path / "run", 0, False)
    assert not (tmp_path / "run").exists()
    with training:
        assert (tmp_path / "run" / "settings.json").exists()


def test_torch_is_bounded_while_it_trains(tmp_path, monkeypatch):
    before = torch.get_num_threads()
    torch.set_num_threads(64)
    try:
        for cores, threads in ((3, 3), (64, MAX_THREADS)):
            monkeypatch.setattr(joblib, "cpu_count", lambda cores=cores: cores)
            monkeypatch.setattr("armctl.rl.run.threads.usable_threads", lambda cores=cores: cores)
            with Training(recipe(), OPTIONS, tmp_path / f"{cores}", 0, False):
                assert torch.get_num_threads() == threads
            assert torch.get_num_threads() == 64
        torch.set_num_threads(1)
        with Training(recipe(), OPTIONS, tmp_path / "one", 0, False):
            assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize("terminal", [True, False])
def test_a_bar_is_for_a_terminal(terminal, monkeypatch):
    for stream in (sys.stdout, sys.stderr):
        monkeypatch.setattr(stream, "isatty", lambda: terminal)
    assert bar_fits(True) is terminal
    assert not bar_fits(False)
