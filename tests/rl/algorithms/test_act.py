import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import FlattenExtractor

from armctl.agents import load_agent
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.rl.algorithms.act import ActOptions, train
from armctl.rl.networks.chunking_transformer import ChunkingTransformer
from armctl.rl.networks.view import ActionScale
from tests.rl.small_trainings import small


def network_of(observations, actions, **options):
    features = FlattenExtractor(spaces.Box(-1, 1, observations.shape[1:]))
    scale = ActionScale(*np.array((-2.0, 2.0))[:, None].repeat(actions.shape[2], axis=1))
    chosen = {"executed": 1, "width": 16, "blocks": 1, "style_weight": 0.1} | options
    return ChunkingTransformer(features, scale, observations, actions, **chosen)


def fitted(observations, actions, steps, **options):
    torch.manual_seed(0)
    network = network_of(observations, actions, **options)
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    for _ in range(steps):
        rows = torch.randint(len(observations), (64,))
        optimizer.zero_grad()
        network.loss(observations[rows], actions[rows]).backward()
        optimizer.step()
    return network


@pytest.mark.slow
def test_a_chunk_is_what_was_shown_action_by_action():
    observations = torch.linspace(-1, 1, 400)[:, None]
    actions = torch.stack([observations.sin(), observations, -observations], dim=1)
    network = fitted(observations, actions, 250)
    with torch.no_grad():
        plans = network.plan(observations)
    assert (plans - actions).abs().mean() < 0.08


@pytest.mark.slow
def test_where_teachers_go_left_or_right_the_style_tells_which():
    torch.manual_seed(1)
    sides = torch.where(torch.rand(2000, 1, 1) < 0.5, -1.0, 1.0)
    nothing = torch.zeros(2000, 1)
    network = fitted(nothing, sides, 250, style_weight=0.01)
    with torch.no_grad():
        styles = 2 * torch.randn(200, 8)
        ends = network.mean + network.unit * network._decoded(network.features(nothing[:200]), styles)
    assert (ends.abs() > 0.8).float().mean() > 0.8  # their mean is 0
    assert 0.2 < (ends > 0).float().mean() < 0.8


def test_heads_share_the_width_of_a_token():
    with pytest.raises(ConfigurationError, match="hidden_units should be a multiple of 4, not 30"):
        ActOptions(hidden_units=30)


@pytest.mark.slow
def test_an_exported_transformer_plays_the_same_alone_and_among_others(tmp_path):
    recipe = small("reach_bc", demonstrations=20, steps=40, evaluation_every=40, hidden_units=32, layers=1)
    card = train(recipe.changed(learner="act"), out=tmp_path / "run", seed=0, progress=False)
    assert (card.family, card.memory) == ("ACT", {"chunk": [24], "age": [1]})
    path = tmp_path / "run" / "agent.json"
    three, one = (make_worlds("armctl/ArmReach-v0", n, recipe.env_options) for n in (3, 1))
    observations = three.reset(seed=5)[0]
    among, single = load_agent(path, three), load_agent(path, one)
    for _ in range(6):
        actions = among.act(observations)
        np.testing.assert_array_equal(actions[1:2], single.act(observations[1:2]))
        observations = three.step(actions)[0]
