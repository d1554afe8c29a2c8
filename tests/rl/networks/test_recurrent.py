"""A recurrent network that starts from one without memory."""

from typing import Any

import numpy as np
import pytest
import torch

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.rl.networks.actor import Actor
from armctl.rl.networks.recurrent import RecurrentNetwork, copy_weights
from armctl.rl.networks.view import view_of


@pytest.mark.parametrize(
    ("agent", "env_id", "features", "units"),
    [
        ("moving_dagger", "armctl/ArmReachMoving-v0", "invariant", 256),
        ("obstacles_plan_bc", "armctl/ArmReachObstacles-v0", "model", 384),  # whose graph has transposed weights
    ],
)
def test_a_network_with_memory_acts_at_first_as_the_one_without_from_which_it_starts(agent, env_id, features, units):
    env = make_worlds(env_id, 3)
    view, space = view_of(env, features=features), env.single_observation_space
    policy: Any = make_policy(agent, env)
    observations, _ = env.reset(seed=5)
    weights = {name: torch.tensor(values) for name, values in policy.numbers.items()}
    network = RecurrentNetwork(view.extractor(space), hidden_units=units, layers=2, memory_units=8, actions=6)
    unit = network.unit.weight_ih.clone()
    copy_weights(network, weights)
    assert torch.equal(network.unit.weight_ih, unit)
    actor = Actor(network, view.action_scale, space, network.memory)
    np.testing.assert_allclose(actor.act(observations), policy.act(observations), atol=1e-5)
    deeper = RecurrentNetwork(view.extractor(space), hidden_units=units, layers=3, memory_units=8, actions=6)
    with pytest.raises(ConfigurationError, match="the training starts from"):
        copy_weights(deeper, weights)
