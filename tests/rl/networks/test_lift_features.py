import numpy as np
import torch

from armctl.envs import make_worlds
from armctl.rl.networks.view import view_of

FIRST_JOINT, VECTORS, VELOCITY = 3, (0, 11, 14, 18, 21, 23), slice(23, 26)
"""Columns at which x and y of vectors begin."""


def turned(observations, angle, columns):
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array(((cosine, sine), (-sine, cosine)), dtype=np.float32)
    result = observations.copy()
    for x in columns:
        result[:, x : x + 2] = observations[:, x : x + 2] @ turn
    return result


def test_scenes_that_are_alike_have_the_same_features():
    env = make_worlds("armctl/ArmLift-v0", 4)
    observations, _ = env.reset(seed=0)
    observations[:, VELOCITY] = np.random.default_rng(0).normal(size=(4, 3))
    view = view_of(env, features="invariant")
    features = view.extractor(env.single_observation_space)
    expected = features(torch.as_tensor(observations))
    assert expected.shape == (4, features.features_dim)
    around = turned(observations, 0.7, VECTORS)
    around[:, FIRST_JOINT] += 0.7
    quarter = turned(observations, np.pi / 2, (21,))  # of the box alone
    for alike in (around, quarter):
        torch.testing.assert_close(features(torch.as_tensor(alike)), expected, atol=1e-4, rtol=1e-4)
    other = features(torch.as_tensor(observations[::-1].copy()))
    assert (other - expected).abs().max() > 0.1
