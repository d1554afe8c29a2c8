"""SAC whose first steps are a teacher's, in small trainings on `armctl/ArmPush-v0`."""

import shutil

import numpy as np
import pandas as pd
import pytest
import torch
from stable_baselines3.common.logger import configure

from armctl.core.errors import ConfigurationError
from armctl.rl.algorithms import sac
from armctl.rl.algorithms.hindsight import GoalVectorEnv
from armctl.rl.algorithms.sac import SacOptions, SquashedMean, TaughtSac, train
from armctl.rl.run.training import Training
from armctl.rollout import evaluate
from armctl.training.learners import load_recipe

SMALL = {
    "steps": 320,
    "worlds": 4,
    "gradient_steps": 2,
    "batch_size": 32,
    "buffer_size": 2000,
    "random_steps": 160,
    "hidden_units": 16,
    "evaluation_every": 80,
    "validation_episodes": 2,
    "evaluation_episodes": 2,
}


def small(**options):
    recipe = load_recipe("push_sac")
    return recipe.changed(options=recipe.options | SMALL | options, env_options={"max_episode_steps": 12})


def taught(out, **options):
    """Return a model that follows its teacher, before its first step."""
    recipe = small(**options)
    training = Training(recipe, recipe.read_options(SacOptions), out, 0, False)
    vec_env = sac._make_vec_env(training, training.options)
    model = sac._new_model(vec_env, training, training.options)
    assert isinstance(vec_env, GoalVectorEnv)
    assert isinstance(model, TaughtSac)
    model.follow(training, training.options)
    model.set_logger(configure(None, []))
    vec_env.seed(0)
    return model


def test_the_teacher_acts_first_and_then_the_mean_of_the_actor(tmp_path):
    model = taught(tmp_path / "run", noise=0.0, random_steps=32)
    env, shown = model.env, []
    proposed = env.actions_of

    def noting(policy):
        shown.append(proposed(policy))
        return shown[-1]

    env.actions_of = noting
    model.learn(44)  # gradient steps begin after 48
    buffer = model.replay_buffer
    np.testing.assert_array_equal(buffer.actions[:8], shown)
    assert np.abs(shown).max() > 0.05
    assert model._meter.read()["teacher_queries"] == 32
    seen = torch.as_tensor(buffer.observations["observation"][8:11]).flatten(0, 1)
    with torch.no_grad():
        means = SquashedMean(model.policy, goals=True)(seen)
    np.testing.assert_allclose(buffer.actions[8:11].reshape(12, 6), means, atol=1e-6)


@pytest.mark.slow
def test_imitation_makes_the_teachers_actions_likely(tmp_path):
    """With a weight beside which values count for nothing, in the same few gradient steps."""
    likelihoods = []
    for weight in (0.0, 1e4):
        model = taught(tmp_path / "run", imitation=weight, learning_rate=3e-3, gradient_steps=1)
        model.learn(4 * 60)
        with torch.no_grad():
            likelihoods.append(float(model.likelihood()))
    assert likelihoods[1] > likelihoods[0] + 1


@pytest.mark.parametrize(
    ("recipe", "message"),
    [
        (load_recipe("reach_sac").changed(options={"imitation": 0.5}), "--teacher POLICY"),
        (small(buffer_size=300), "buffer_size to steps at least"),
        (small().changed(env_options={"observation": "full"}), "relabelled to 0"),
        (small().changed(shaping="push"), "relabelled to 0"),
    ],
    ids=["no teacher", "small buffer", "other observation", "other reward"],
)
def test_what_does_not_fit_together_is_refused(tmp_path, recipe, message):
    with pytest.raises(ConfigurationError, match=message):
        train(recipe, out=tmp_path / "run", seed=0)
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_training_is_resumed_with_its_teacher_and_leaves_a_runnable_agent(tmp_path):
    out = tmp_path / "small"
    card = train(small(steps=80), out=out, seed=1, progress=False)
    assert card.training_steps == 80
    card = train(small(), out=shutil.copytree(out, tmp_path / "resumed"), seed=1, resume=True, progress=False)
    assert (card.training_steps, card.cost.teacher_queries) == (320, 160)
    assert [line.name for line in card.lineage] == ["push_line:memory=false"]
    assert pd.read_csv(tmp_path / "resumed" / "curve.csv").steps.tolist() == [0, 80, 160, 240, 320]
    assert len(evaluate(str(tmp_path / "resumed" / "agent.json"), env="armctl/ArmPush-v0", episodes=2)) == 2
