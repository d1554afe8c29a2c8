"""The losses of actors."""

import gymnasium
import numpy as np
import pytest
import torch

from armctl.rl.networks.actor import SMALL_DISTANCE, Actor, MedianActor
from armctl.rl.networks.view import ActionScale

SPACE = gymnasium.spaces.Box(-1, 1, (3,), np.float32)
SCALE = ActionScale(np.full(2, -0.5), np.full(2, 0.5))


class Constant(torch.nn.Module):
    """A network with the same outputs for all observations."""

    def __init__(self, *outputs):
        super().__init__()
        self.outputs = torch.nn.Parameter(torch.tensor(outputs))

    def forward(self, observations):
        return self.outputs.expand(len(observations), -1)


def fitted(kind, labels):
    """Outputs that have the least loss for labels (n, 2), in the network's unit."""
    network = Constant(0.0, 0.0)
    actor, optimizer = kind(network, SCALE, SPACE), torch.optim.Adam(network.parameters(), 0.05)
    for step in range(300):
        optimizer.param_groups[0]["lr"] = 0.05 * (1 - step / 300)
        loss = actor.loss(torch.zeros(len(labels), 3), 0.5 * torch.tensor(labels))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return network.outputs.detach().numpy()


def test_the_median_is_the_more_frequent_way_and_the_mean_is_none():
    labels = [[0.8, 0.5]] * 6 + [[-0.8, -0.5]] * 4
    np.testing.assert_allclose(fitted(Actor, labels), [0.16, 0.1], atol=1e-3)
    np.testing.assert_allclose(fitted(MedianActor, labels), [0.8, 0.5], atol=2 * SMALL_DISTANCE)


@pytest.mark.parametrize(("outputs", "distance"), [((3.0, -2.0), 0.0), ((-3.0, -2.0), 4.0), ((3.0, 0.5), 1.5)])
def test_outputs_beyond_a_label_at_its_bound_are_right(outputs, distance):
    actor = MedianActor(Constant(*outputs), SCALE, SPACE)
    loss = actor.loss(torch.zeros(5, 3), torch.tensor([[2.0, -0.5]] * 5))  # the first one is beyond the range
    assert loss.item() == pytest.approx(np.hypot(distance, SMALL_DISTANCE), rel=1e-5)


def test_only_at_a_bound_more_is_right():
    actor = MedianActor(Constant(3.0, 0.0), SCALE, SPACE)
    assert actor.loss(torch.zeros(1, 3), torch.tensor([[0.45, 0.0]])).item() == pytest.approx(2.1, rel=1e-3)
