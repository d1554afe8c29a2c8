"""What is checked of an exported network, whatever its features."""

import numpy as np
import torch

from armctl.agents.graph import load_graph
from armctl.rl.networks.actor import Actor
from armctl.rl.networks.view import view_of


def check_graph(worlds, features, folder, placed=lambda observations: observations):
    """Check that a network's graph acts like the network, and in a world alone bit for bit as among others.

    `placed` turns observations of resets into those to act on.
    """
    network = torch.nn.Sequential(features, torch.nn.Linear(features.features_dim, worlds.single_action_space.shape[0]))
    actor = Actor(network, view_of(worlds, features="model").action_scale, worlds.single_observation_space)
    actor.export(folder / "agent.onnx")
    graph = load_graph(folder / "agent.onnx")
    observations = placed(worlds.reset(seed=3)[0])
    together = graph.run({"observation": observations})[0]
    np.testing.assert_allclose(together, actor.act(observations), atol=1e-5)
    alone = [graph.run({"observation": observations[i : i + 1]})[0][0] for i in range(len(observations))]
    np.testing.assert_array_equal(alone, together)
