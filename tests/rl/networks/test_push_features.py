import numpy as np
import torch

from armctl.envs import make_worlds
from armctl.rl.networks.view import view_of

FIRST_JOINT, PLACES, AXIS, VELOCITY = 3, (slice(0, 3), slice(9, 12), slice(12, 15)), slice(15, 17), slice(17, 20)


def turned(observations, angle):
    """The same scenes, turned about the vertical through the arm's base."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.array(((cosine, sine), (-sine, cosine)), dtype=np.float32)
    result = observations.copy()
    for part in (*PLACES, AXIS, VELOCITY):
        xy = slice(part.start, part.start + 2)
        result[:, xy] = observations[:, xy] @ turn
    result[:, FIRST_JOINT] += angle
    return result


def test_scenes_that_are_alike_have_the_same_features():
    env = make_worlds("armctl/ArmPush-v0", 4)
    observations, _ = env.reset(seed=0)
    observations[:, VELOCITY] = np.random.default_rng(0).normal(size=(4, 3))
    view = view_of(env, features="invariant")
    features = view.extractor(env.single_observation_space)
    mirrored = observations.copy()
    mirrored[:, AXIS] *= -1  # a box turned by half a turn
    expected = features(torch.as_tensor(observations))
    assert expected.shape == (4, features.features_dim)
    for alike in (turned(observations, 0.7), mirrored):
        torch.testing.assert_close(features(torch.as_tensor(alike)), expected, atol=1e-5, rtol=1e-5)
    other = features(torch.as_tensor(observations[::-1].copy()))
    assert (other - expected).abs().max() > 0.1
