import copy

import numpy as np
import pytest
import torch

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.rl.algorithms.anchored_ppo import AnchoredPpo
from armctl.rl.algorithms.cloned_ppo import ClonedPpoOptions
from armctl.rl.algorithms.ppo import new_model
from armctl.rl.networks.view import view_of
from armctl.rl.run.vector import StableBaselinesVectorEnv
from armctl.shaping import Shaped
from armctl.training.learners import load_recipe

OPTIONS = ClonedPpoOptions(worlds=16, rollout_length=16, batch_size=64, hidden_units=32, layers=1, gamma=0.9)


@pytest.fixture
def model():
    worlds = make_worlds("armctl/ArmReach-v0", 16, {"reward_scale": 0.02}, autoreset_mode="same_step")
    view, shaped = view_of(worlds), Shaped(worlds, "distance", gamma=OPTIONS.gamma, scale=120.0)
    made = new_model(StableBaselinesVectorEnv(shaped, view), OPTIONS, 0, AnchoredPpo)
    yield made
    worlds.close()


def weights(model):
    return {name: values.clone() for name, values in model.policy.state_dict().items()}


def fitted(model, steps, learning_rate=1e-3):
    return list(model.fit_critic(steps, torch.optim.Adam(model.critic_parameters(), learning_rate)))


@pytest.mark.slow
def test_fitting_the_critic_leaves_the_actor_and_explains_returns_better(model):
    before = weights(model)
    explained = fitted(model, 12 * 256)
    changed = {name for name, values in weights(model).items() if not torch.equal(values, before[name])}
    assert changed
    assert all("value_net" in name for name in changed)
    assert max(explained) > max(0.5, explained[0] + 0.1)
    assert model.num_timesteps == 256 * len(explained)
    assert model.rollout_buffer.gae_lambda == OPTIONS.gae_lambda


@pytest.mark.slow
def test_the_critic_is_fitted_until_it_gains_no_more_and_no_longer_than_asked(model):
    assert len(fitted(model, 3 * 256)) <= 3
    without_a_gain = fitted(model, 50 * 256, 1e-12)
    assert len(without_a_gain) < 12


@pytest.mark.slow
def test_the_distance_from_the_anchor_is_the_divergence_of_gaussians(model):
    observations = torch.as_tensor(np.stack([model.observation_space.sample() for _ in range(5)]))
    assert not model.distance_from_anchor(observations).any()
    with torch.no_grad():
        model.policy.action_net.bias += 0.05
    distance = model.distance_from_anchor(observations)
    expected = torch.distributions.kl_divergence(
        model.policy.get_distribution(observations).distribution,
        model.anchor.get_distribution(observations).distribution,
    ).sum(dim=1)
    torch.testing.assert_close(distance, expected)
    assert (distance > 0).all()
    model.set_kl_anchor()
    assert not model.distance_from_anchor(observations).any()


def test_without_weight_it_is_ppo(model):
    """One update by the same rollout changes the weights as PPO's own does."""
    model.learn(256)  # makes logger and rollout
    model._current_progress_remaining = 0.5
    start, optimizer = copy.deepcopy(model.policy.state_dict()), copy.deepcopy(model.policy.optimizer.state_dict())
    found = []
    for train in (AnchoredPpo.train, AnchoredPpo.__mro__[1].train):
        model.policy.load_state_dict(start)
        model.policy.optimizer.load_state_dict(copy.deepcopy(optimizer))
        np.random.seed(0)  # noqa: NPY002 - by which PPO's buffer shuffles
        train(model)
        found.append(weights(model))
    for name, values in found[0].items():
        torch.testing.assert_close(values, found[1][name], atol=1e-6, rtol=1e-4)
    assert any(not torch.equal(values, start[name]) for name, values in found[0].items())


def moved(model, weight, past):
    """How far from the anchor an update goes, given what share of the training is past."""
    model.anchor_weight, model.anchor_decay = weight, 0.5
    model._current_progress_remaining = 1 - past
    model.policy.load_state_dict(model.anchor.state_dict())
    model.policy.optimizer.state.clear()
    np.random.seed(0)  # noqa: NPY002 - by which PPO's buffer shuffles
    model.train()
    observations = torch.as_tensor(model.rollout_buffer.observations).reshape(-1, *model.observation_space.shape)
    return float(model.distance_from_anchor(observations).mean().detach())


def test_the_penalty_holds_the_actor_to_the_anchor_until_it_has_decayed(model):
    model.learn(256)
    model.set_kl_anchor()
    held, half, free = moved(model, 30.0, 0.0), moved(model, 30.0, 0.45), moved(model, 30.0, 0.5)
    assert 0 < held < half < free
    assert held < 0.7 * free


def test_a_checkpoint_has_the_anchor(model, tmp_path):
    with torch.no_grad():
        model.policy.action_net.bias += 0.3
    model.save(tmp_path / "model.zip")
    loaded = AnchoredPpo.load(tmp_path / "model.zip", model.env, "cpu")
    for name, values in model.anchor.state_dict().items():
        assert torch.equal(values, loaded.anchor.state_dict()[name])
    assert not torch.equal(loaded.anchor.action_net.bias, loaded.policy.action_net.bias)
    assert not any(parameter.requires_grad for parameter in loaded.anchor.parameters())


@pytest.mark.parametrize("options", [{"anchor_weight": -1.0}, {"anchor_decay": 0.0}, {"anchor_decay": 2.0}])
def test_weights_and_decays_out_of_range_are_refused(options):
    recipe = load_recipe("reach_cloned_ppo")
    with pytest.raises(ConfigurationError, match=next(iter(options))):
        recipe.changed(options=options).read_options(ClonedPpoOptions)
