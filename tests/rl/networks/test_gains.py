"""Gains on errors that vanish at the target."""

import numpy as np
import pytest
import torch

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.rl.data.demonstrations import ACHIEVED, slices_of_parts
from armctl.rl.networks.gains import GainNetwork
from armctl.rl.networks.view import view_of


@pytest.fixture(params=["ArmPose-v0", "ArmReach-v0", "ArmReachObstacles-v0", "ArmScenes-v0"])
def worlds(request):
    envs = make_worlds(f"armctl/{request.param}", 6, {})
    yield envs, envs.reset(seed=1)[0]
    envs.close()


def network_for(envs, features="invariant"):
    extractor = view_of(envs, features=features).extractor(envs.single_observation_space)
    return GainNetwork(extractor, [32, 32], 6)


def test_it_stands_still_at_its_target_and_nowhere_else(worlds):
    envs, observations = worlds
    network, parts = network_for(envs), slices_of_parts(envs.task)
    actions = network(torch.as_tensor(observations))
    assert actions.shape == (6, 6)
    assert (actions.abs().amax(dim=1) > 1e-3).all()
    at_target = observations.copy()
    for goal, place in ACHIEVED.items():
        if goal in parts:
            at_target[:, parts[goal]] = at_target[:, parts[place]]
            partly = at_target.copy()
    assert network(torch.as_tensor(at_target)).abs().max() < 1e-5
    if "target_axes" in parts:  # the position alone is not enough, not even with half a turn to go
        partly[:, parts["target_axes"]] = -observations[:, parts["end_effector_axes"]]
        assert (network.features.errors(network.features(torch.as_tensor(partly))).norm(dim=1) > 0.5).all()


def test_errors_fade_near_the_target(worlds):
    envs, observations = worlds
    network, parts = network_for(envs), slices_of_parts(envs.task)
    norms = []
    for distance in (0.4, 0.1, 0.02, 0.004):
        near = observations.copy()
        for goal, place in ACHIEVED.items():
            if goal in parts:
                near[:, parts[goal]] = near[:, parts[place]]
        near[:, parts["target_position"]] += np.array([distance, 0, 0], dtype=np.float32)
        errors = network.features.errors(network.features(torch.as_tensor(near)))
        norms.append(errors.norm(dim=1).detach().numpy())
    assert (np.diff(norms, axis=0) < 0).all()
    assert (norms[-1] < 0.1).all()


def test_features_without_errors_are_refused():
    envs = make_worlds("armctl/ArmReach-v0", 1, {})
    with pytest.raises(ConfigurationError, match="features = 'invariant'"):
        network_for(envs, features="none")
    envs.close()
