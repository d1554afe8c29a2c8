import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import FlattenExtractor

from armctl.agents import load_agent
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.rl.algorithms.td_mpc2 import Replay, TdMpcOptions, train
from armctl.rl.networks.world_model import Binned, Mish, Planner, Shares, WorldModel
from tests.rl.small_trainings import small


@pytest.mark.one_case
@pytest.mark.parametrize("number", [-90.0, -1.0, 0.0, 0.3, 7.0, 100.0])
def test_a_number_is_learned_by_its_bins(number):
    torch.manual_seed(0)
    binned, inputs = Binned([2, 8]), torch.ones(1, 2)
    optimizer = torch.optim.Adam(binned.parameters(), 0.03)
    for _ in range(300):
        optimizer.zero_grad()
        binned.loss(inputs, torch.tensor([number])).mean().backward()
        optimizer.step()
    with torch.no_grad():
        assert binned(inputs).item() == pytest.approx(number, rel=0.1, abs=0.05)


def test_shares_sum_to_one_in_each_group():
    shares = Shares()(torch.randn(3, 24)).unflatten(1, (3, 8))
    assert (shares > 0).all()
    torch.testing.assert_close(shares.sum(dim=2), torch.ones(3, 3))


@pytest.mark.parametrize("steps", [4, 5, 9, 23])
def test_sequences_are_as_they_happened(steps):
    replay = Replay(5, 2, (1,), 1)
    for t in range(steps):
        now, done = np.array([t, 100 + t], np.float32), np.array([t % 3 == 2, False])
        replay.add(
            observations=now[:, None], next=now[:, None] + 1, actions=now[:, None], rewards=now,
            terminated=done, done=done,
        )  # fmt: skip
    drawn = replay.draw(np.random.default_rng(0), 200, 3)
    firsts = drawn["observations"][0, :, 0]
    for k in range(3):
        torch.testing.assert_close(drawn["rewards"][k], firsts + k)
        torch.testing.assert_close(drawn["next"][k, :, 0], firsts + k + 1)
    assert set((firsts % 100).tolist()) == set(range(max(0, steps - 5), steps - 2))
    ended = (drawn["done"].cumsum(dim=0) - drawn["done"]) > 0
    assert torch.equal(drawn["goes_on"], (~ended).float())


def test_the_planner_finds_what_the_model_rewards():
    torch.manual_seed(0)
    space = spaces.Box(-1, 1, (2,), np.float32)
    model = WorldModel(FlattenExtractor(space), 2, hidden=16, latent=8, critics=2)
    best = torch.tensor([0.6, -0.3])

    class Reward(torch.nn.Module):
        def forward(self, inputs):
            return -(inputs[..., -2:] - best).square().sum(dim=-1)

    model.reward = Reward()
    planner = Planner(model, gamma=0.9, horizon=3, samples=64, from_prior=8, elites=8, rounds=4)
    with torch.no_grad():
        actions, plan = planner(torch.zeros(5, 2), torch.zeros(5, 6))
    assert plan.shape == (5, 6)
    assert (actions - best).abs().max() < 0.15
    torch.testing.assert_close(plan[:, 4:], torch.zeros(5, 2))  # what was planned moves up


def test_what_comes_after_an_episode_counts_for_nothing():
    torch.manual_seed(0)
    model = WorldModel(FlattenExtractor(spaces.Box(-1, 1, (2,), np.float32)), 2, hidden=16, latent=8, critics=2)
    for part in (model.reward, *model.critics):
        torch.nn.init.normal_(part.layers[-1].weight)
    latents, actions = torch.full((6, 8), 0.125), torch.randn(3, 6, 2)
    with torch.no_grad():
        going_on = model.imagined(latents, actions, 0.9)
        first = model.reward(torch.cat((latents, actions[0]), dim=-1))
        model.termination[-1].bias.fill_(1.0)
        torch.testing.assert_close(model.imagined(latents, actions, 0.9), first)
    assert (going_on != first).all()


def test_new_noise_is_another_and_has_the_priors_own_plan():
    model = WorldModel(FlattenExtractor(spaces.Box(-1, 1, (2,), np.float32)), 2, hidden=16, latent=8, critics=2)
    planner = Planner(model, gamma=0.9, horizon=3, samples=16, from_prior=4, elites=4, rounds=2)
    before = planner.noise.clone()
    planner.draw_noise()
    assert (planner.noise != before).all()
    assert not planner.prior_noise[:, 0].any()
    assert planner.prior_noise[:, 1:].all()


def test_fewer_are_elites_than_are_sampled():
    with pytest.raises(ConfigurationError, match="of 16 samples, fewer are from the prior, and fewer are elites"):
        TdMpcOptions(samples=16, elites=16)


@pytest.mark.slow
def test_a_training_gives_an_agent_that_plays_the_same_alone_and_among_others(tmp_path):
    planning = {"horizon": 2, "samples": 12, "from_prior": 4, "elites": 4, "rounds": 1}
    sizes = {"worlds": 8, "hidden_units": 32, "latent": 16, "batch_size": 16, "gradient_steps": 2}
    judged = {"validation_episodes": 4, "evaluation_episodes": 4, "evaluation_every": 160}
    options = judged | planning | sizes | {"steps": 160, "random_steps": 64, "frames": 2}
    recipe = small("reach_ppo").changed(learner="td_mpc2", options=options)
    card = train(recipe, out=tmp_path / "run", seed=0, progress=False)
    assert (card.family, card.training_steps) == ("TD-MPC2", 160)
    assert card.memory == {"past_observation": [1, 12], "begun": [1], "plan": [12]}
    resumed = train(recipe.changed(options=recipe.options | {"steps": 320}), out=tmp_path / "run", seed=0, resume=True,
                    progress=False)  # fmt: skip
    assert resumed.training_steps == 320
    three, one = (make_worlds("armctl/ArmReach-v0", n, recipe.env_options) for n in (3, 1))
    observations = three.reset(seed=5)[0]
    among, single = (load_agent(tmp_path / "run" / "agent.json", worlds) for worlds in (three, one))
    for _ in range(6):
        actions = among.act(observations)
        np.testing.assert_allclose(actions[1:2], single.act(observations[1:2]), atol=1e-5)
        observations = three.step(actions)[0]


@pytest.mark.slow
def test_mish_is_exported_as_the_same_function(monkeypatch):
    numbers = torch.linspace(-120, 120, 4801)
    expected = torch.nn.functional.mish(numbers)
    torch.testing.assert_close(Mish()(numbers), expected)
    monkeypatch.setattr(torch.compiler, "is_exporting", lambda: True)
    torch.testing.assert_close(Mish()(numbers), expected, atol=1e-7, rtol=1e-6)
