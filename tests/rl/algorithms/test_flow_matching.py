import numpy as np
import pytest
import torch
from stable_baselines3.common.torch_layers import FlattenExtractor

from armctl.agents import load_agent
from armctl.core.errors import ConfigurationError
from armctl.datasets.demonstrations import Demonstration
from armctl.envs import make_worlds
from armctl.rl.algorithms.chunking import ChunkActor, Chunks
from armctl.rl.algorithms.flow_matching import FlowOptions, train
from armctl.rl.networks.flow import FlowNetwork
from armctl.rl.networks.view import ActionScale, Unscaled
from tests.rl.small_trainings import small


def network_of(observations, actions, **options):
    space = make_worlds("armctl/ArmReach-v0", 1).single_observation_space
    chosen = {"executed": 1, "euler_steps": 5, "hidden": [32, 32]} | options
    features = FlattenExtractor(space)
    features._features_dim = observations.shape[1]
    scale = ActionScale(*np.array((-2.0, 2.0))[:, None].repeat(actions.shape[2], axis=1))
    return FlowNetwork(features, scale, observations, actions, **chosen)


def test_where_teachers_go_left_or_right_a_flow_goes_one_way():
    torch.manual_seed(0)
    sides = torch.where(torch.rand(2000, 1, 1) < 0.5, -1.0, 1.0)
    nothing = torch.zeros(2000, 1)
    network = network_of(nothing, sides, hidden=[64, 64])
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    for _ in range(300):
        optimizer.zero_grad()
        network.loss(nothing[:256], sides[torch.randint(2000, (256,))]).backward()
        optimizer.step()
    ends = []
    for latent in (-1.5, -0.7, 0.7, 1.5):
        network.latent.fill_(latent)
        ends.append(network(nothing[:1]).item())
    np.testing.assert_allclose(np.abs(ends), 1.0, atol=0.25)  # their mean is 0
    assert np.sign(ends).tolist() == [-1, -1, 1, 1]


def test_a_chunk_is_executed_before_the_next_one_is_planned():
    rng = torch.Generator().manual_seed(1)
    observations, actions = torch.rand(50, 9, generator=rng), torch.rand(50, 4, 2, generator=rng)
    network = network_of(observations, actions, executed=3)
    network.latent.normal_()
    space = make_worlds("armctl/ArmReach-v0", 1).single_observation_space
    actor = ChunkActor(network, Unscaled(), space, network.memory)
    seen = observations[:12].reshape(6, 2, 9).numpy()
    with torch.no_grad():
        plans = [network.plan(torch.as_tensor(step)).numpy() for step in seen]
    played = []
    for step in range(6):
        if step == 4:
            actor.reset(np.array([1], dtype=np.int32))
        played.append(actor.act(seen[step]))
    world_0 = [plans[0][0, 0], plans[0][0, 1], plans[0][0, 2], plans[3][0, 0], plans[3][0, 1], plans[3][0, 2]]
    world_1 = [plans[0][1, 0], plans[0][1, 1], plans[0][1, 2], plans[3][1, 0], plans[4][1, 0], plans[4][1, 1]]
    np.testing.assert_allclose(np.array(played), np.stack((world_0, world_1), axis=1), rtol=1e-5)


def test_examples_are_the_next_actions_and_an_episode_ends_with_its_last():
    task = make_worlds("armctl/ArmReach-v0", 1).task
    chunks = Chunks(task, 3)
    for begin, length in ((0.0, 4), (10.0, 2)):
        numbers = begin + np.arange(length + 1, dtype=np.float32)
        chunks.add([Demonstration(numbers[:, None], numbers[:-1, None], np.zeros(length), True, False)])
    observations, actions = chunks.draw(np.random.default_rng(0), 200)
    for observation, chunk in zip(observations[:, 0].tolist(), actions[..., 0].tolist(), strict=True):
        last = 3.0 if observation < 10 else 11.0
        assert chunk == [min(observation + i, last) for i in range(3)]
    assert len(set(observations[:, 0].tolist())) == 6


def test_no_more_than_a_chunk_is_executed():
    with pytest.raises(ConfigurationError, match="of a chunk of 4 control steps, 5 cannot"):
        FlowOptions(chunk=4, executed=5)


@pytest.mark.slow
def test_an_exported_flow_plays_the_same_alone_and_among_others(tmp_path):
    recipe = small("reach_bc", demonstrations=20, steps=40, evaluation_every=40).changed(learner="flow_matching")
    card = train(recipe, out=tmp_path / "run", seed=0, progress=False)
    assert card.memory == {"chunk": [24], "age": [1]}
    path = tmp_path / "run" / "agent.json"
    three, one = (make_worlds("armctl/ArmReach-v0", n, recipe.env_options) for n in (3, 1))
    observations = [three.reset(seed=5)[0]]
    among, single = load_agent(path, three), load_agent(path, one)
    for _ in range(6):
        actions = among.act(observations[-1])
        np.testing.assert_array_equal(actions[1:2], single.act(observations[-1][1:2]))
        observations.append(three.step(actions)[0])
