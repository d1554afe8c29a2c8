import types
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, FlattenExtractor

from armctl.core.arrays import map_arrays
from armctl.datasets.demonstrations import Demonstration
from armctl.envs import make_worlds
from armctl.rl.algorithms.cloning import fit
from armctl.rl.algorithms.iql import IqlActor, IqlOptions, Transitions, train
from armctl.rl.networks.actor import Actor, tensors
from armctl.rl.networks.view import ActionScale
from tests.rl.small_trainings import small


def test_transitions_know_what_followed_and_whether_more_would():
    transitions = Transitions(make_worlds("armctl/ArmReach-v0", 1).task)
    for begin, length, terminated in ((0.0, 4, True), (10.0, 2, False)):
        numbers = begin + np.arange(length + 1, dtype=np.float32)
        transitions.add(
            [Demonstration(numbers[:, None], numbers[:-1, None], numbers[:-1].astype(np.float64), terminated, False)]
        )
    observations, followed = transitions.draw(np.random.default_rng(0), 300)
    np.testing.assert_array_equal(followed["next"], observations + 1)
    np.testing.assert_array_equal(followed["actions"], observations)
    np.testing.assert_array_equal(followed["rewards"], observations[:, 0])
    np.testing.assert_array_equal(followed["goes_on"], observations[:, 0] != 3)  # the other was cut short
    assert set(observations[:, 0]) == {0, 1, 2, 3, 10, 11}


class Drawn:
    """Rows of arrays."""

    def __init__(self, observations, **followed):
        self.observations, self.followed = observations, followed

    def draw(self, rng, size):
        """Return a random batch."""
        rows = rng.integers(len(self.observations), size=size)
        return tensors(self.observations[rows]), map_arrays(lambda values: values[rows], self.followed)


class LearnedFeatures(BaseFeaturesExtractor):
    """Features with weights, which each network learns by itself."""

    def __init__(self, space):
        super().__init__(space, 16)
        self.layer = torch.nn.Linear(space.shape[0], 16)

    def forward(self, observations):
        """Return features (n, 16)."""
        return self.layer(observations).relu()


def fitted(drawn, steps, extractor=FlattenExtractor, **options):
    torch.manual_seed(0)
    space = spaces.Box(-1, 1, (drawn.observations.shape[1],), np.float32)
    scale = ActionScale(-np.ones(1), np.ones(1))
    view = types.SimpleNamespace(extractor=extractor, action_scale=scale)
    held_out = types.SimpleNamespace(single_observation_space=space, single_action_space=spaces.Box(-1, 1, (1,)))
    meter = types.SimpleNamespace(watch=lambda optimizer: None)
    training: Any = types.SimpleNamespace(view=view, held_out=held_out, meter=meter, shows_bars=False)
    features = extractor(space)
    layers = torch.nn.Linear(features.features_dim, 32), torch.nn.ReLU(), torch.nn.Linear(32, 1)
    network = torch.nn.Sequential(features, *layers)
    chosen = IqlOptions(**({"hidden_units": 32, "layers": 2, "reward_scale": 1.0} | options))
    actor = IqlActor(Actor(network, scale, space), training, chosen)
    for _ in fit(training, actor, drawn, steps, np.random.default_rng(0), batch_size=128, learning_rate=3e-3):
        pass
    return actor


@pytest.mark.slow
@pytest.mark.parametrize("extractor", [FlattenExtractor, LearnedFeatures])
def test_it_does_what_was_good_among_what_was_done(extractor):
    rng = np.random.default_rng(1)
    observations = rng.uniform(-1, 1, (3000, 2)).astype(np.float32)
    actions = rng.choice([-0.6, 0.6], (3000, 1)).astype(np.float32)
    rewards = (np.sign(observations[:, 0]) == np.sign(actions[:, 0])).astype(np.float32)
    over = np.zeros(3000, np.float32)
    drawn = Drawn(observations, actions=actions, rewards=rewards, next=observations, goes_on=over)
    chosen = fitted(drawn, 500, extractor, temperature=6.0).act(observations)[:, 0]
    clear = np.abs(observations[:, 0]) > 0.2
    right = np.sign(chosen[clear]) == np.sign(observations[clear, 0])
    assert right.mean() > 0.95
    assert np.abs(chosen[clear]).mean() > 0.4  # a clone's mean is 0


@pytest.mark.slow
def test_values_count_what_comes_later_unless_the_episode_ends():
    rng = np.random.default_rng(2)
    states = np.eye(3, dtype=np.float32)  # two steps to an end with a reward of 1
    rows = rng.integers(2, size=2000)
    drawn = Drawn(
        states[rows],
        actions=rng.uniform(-1, 1, (2000, 1)).astype(np.float32),
        rewards=(rows == 1).astype(np.float32),
        next=states[rows + 1],
        goes_on=(rows == 0).astype(np.float32),
    )
    actor = fitted(drawn, 500, gamma=0.5, tau=0.05)
    with torch.no_grad():
        values = actor.value(torch.as_tensor(states[:2])).numpy()
    np.testing.assert_allclose(values, [0.5, 1.0], atol=0.08)


@pytest.mark.slow
def test_a_training_gives_an_agent_and_resumes(tmp_path):
    recipe = small("reach_bc", demonstrations=20, steps=60, evaluation_every=30).changed(learner="iql")
    whole = train(recipe, out=tmp_path / "whole", seed=0, progress=False)
    assert (whole.family, whole.memory, whole.training_steps) == ("IQL", {}, 60)
    half = recipe.changed(options=recipe.options | {"steps": 30})
    train(half, out=tmp_path / "run", seed=0, progress=False)
    resumed = train(recipe, out=tmp_path / "run", seed=0, resume=True, progress=False)
    assert resumed.training_steps == 60
    assert resumed.decisions == whole.decisions
