"""The network of a flow-matching policy: a flow over chunks of actions.

It predicts where the flow ends, from which the velocity follows: (end - place) / (1 - time). The velocity itself has
the noise in it, which a small network passes on with errors that are larger than the accuracy that actions need.
"""

from collections.abc import Sequence
from typing import Any

import torch

from armctl.rl.networks.chunks import ChunkNetwork
from armctl.rl.networks.layers import hidden_layers

FREQUENCIES = 4
"""Count of frequencies by which the network is told the time of the flow."""


class FlowNetwork(ChunkNetwork):
    """Plans chunks by `euler_steps` steps along the flow from `latent` (length * k,)."""

    latent: torch.Tensor

    def __init__(self, *args: Any, euler_steps: int, hidden: Sequence[int], **options: Any) -> None:
        super().__init__(*args, **options)
        self._euler_steps = euler_steps
        size = len(self.mean)
        inputs = self.features.features_dim + size + 2 * FREQUENCIES
        self.ends = torch.nn.Sequential(*hidden_layers([inputs, *hidden]), torch.nn.Linear(hidden[-1], size))
        self.register_buffer("latent", torch.zeros(size))
        self.register_buffer("frequencies", torch.pi * 2.0 ** torch.arange(FREQUENCIES))

    def error(self, observations: Any, chunks: torch.Tensor) -> torch.Tensor:
        """Return the mean squared error of the ends, at random times of the flow to chunks (n, length * k)."""
        begins, times = torch.randn_like(chunks), torch.rand(len(chunks), 1)
        places = begins + times * (chunks - begins)
        return (self._ends(self.features(observations), places, times) - chunks).square().mean()

    def planned(self, observations: Any) -> torch.Tensor:
        """Return chunks (n, length * k), in units of their standard deviation."""
        features = self.features(observations)
        places = self.latent + torch.zeros_like(features[:, :1])
        for step in range(self._euler_steps):
            times = torch.full_like(features[:, :1], step / self._euler_steps)
            velocity = (self._ends(features, places, times) - places) / (1 - times)
            places = places + velocity / self._euler_steps
        return places

    def _ends(self, features: torch.Tensor, places: torch.Tensor, times: torch.Tensor) -> torch.Tensor:
        waves = times * self.frequencies
        return self.ends(torch.cat((features, places, waves.sin(), waves.cos()), dim=1))
