"""Features of an object on a table: pushed, or lifted."""

import numpy as np
import pytest
import torch

from armctl.envs import make_worlds
from armctl.rl.networks.view import view_of

FIRST_JOINT = 3
SCENES = {
    "armctl/ArmPush-v0": ((0, 9, 12, 15, 17), 15, np.pi, 17),
    "armctl/ArmLift-v0": ((0, 11, 14, 18, 21, 23), 21, np.pi / 2, 23),
}
"""Columns at which vectors begin, that of the object's axis, a turn after which its box is the same, and that at which
its velocity begins."""


def turned(observations, angle, columns):
    """The same scenes, with the vectors at these columns turned about the vertical through the arm's base."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array(((cosine, sine), (-sine, cosine)), dtype=np.float32)
    result = observations.copy()
    for x in columns:
        result[:, x : x + 2] = observations[:, x : x + 2] @ turn
    return result


@pytest.mark.parametrize("env_id", SCENES)
def test_scenes_that_are_alike_have_the_same_features(env_id):
    vectors, axis, symmetry, velocity = SCENES[env_id]
    env = make_worlds(env_id, 4)
    observations, _ = env.reset(seed=0)
    observations[:, velocity : velocity + 3] = np.random.default_rng(0).normal(size=(4, 3))
    features = view_of(env, features="invariant").extractor(env.single_observation_space)
    expected = features(torch.as_tensor(observations))
    assert expected.shape == (4, features.features_dim)
    around = turned(observations, 0.7, vectors)
    around[:, FIRST_JOINT] += 0.7
    for alike in (around, turned(observations, symmetry, (axis,))):
        torch.testing.assert_close(features(torch.as_tensor(alike)), expected, atol=1e-4, rtol=1e-4)
    other = features(torch.as_tensor(observations[::-1].copy()))
    assert (other - expected).abs().max() > 0.1
