"""A recurrent network, whose memory is the state of a gated recurrent unit (Cho et al., EMNLP 2014)."""

from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.rl.networks.layers import hidden_layers

MEMORY = "hidden"
"""Name of the memory."""


class RecurrentNetwork(torch.nn.Module):
    """Features and an encoder, a gated recurrent unit, and layers from its state and the encoder to actions."""

    def __init__(
        self, features: BaseFeaturesExtractor, *, hidden_units: int, layers: int, memory_units: int, actions: int
    ) -> None:
        super().__init__()
        self.encoder = torch.nn.Sequential(
            features, torch.nn.Linear(features.features_dim, hidden_units), torch.nn.ReLU()
        )
        self.unit = torch.nn.GRUCell(hidden_units, memory_units)
        self.memory = {MEMORY: (memory_units,)}
        sizes = [hidden_units + memory_units] + [hidden_units] * layers
        self.head = torch.nn.Sequential(*hidden_layers(sizes), torch.nn.Linear(sizes[-1], actions))

    def recall(self, observation: Any, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what the head sees (n, j), and the next state, for observations (n, ...) and states (n, m)."""
        encoded = self.encoder(observation)
        hidden = self.unit(encoded, hidden)
        return torch.cat((encoded, hidden), dim=1), hidden

    def forward(self, observation: Any, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return actions (n, k), mostly in [-1, 1], and the next state, for observations (n, ...), states (n, m)."""
        recalled, hidden = self.recall(observation, hidden)
        return self.head(recalled), hidden
