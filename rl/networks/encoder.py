"""Encoders, which do not learn: what they make of observations and of a memory is what a learner sees.

While an agent learns, its worlds show that (`armctl.rl.run.vector`). The exported agent has the encoder in its graph.
"""

from abc import ABC, abstractmethod
from typing import Any

import gymnasium
import torch

from armctl.rl.networks.view import View


class Encoder(torch.nn.Module, ABC):
    """A map of observations (n, ...) and a memory, before the network that learns."""

    memory: dict[str, tuple[int, ...]]
    """Shapes of what has to be remembered, by name; empty if nothing has."""
    space: gymnasium.Space[Any]
    """Space of an encoded observation."""

    @abstractmethod
    def rebuilt_for(self, view: View, observation_space: gymnasium.Space[Any]) -> "Encoder":
        """Return the same encoder for other observations, which are prepared alike."""

    @abstractmethod
    def features(self, view: View) -> dict[str, Any]:
        """Return the arguments of a policy of Stable-Baselines3 for features of encoded observations."""

    @abstractmethod
    def forward(self, observation: Any, *memory: torch.Tensor) -> tuple[Any, ...]:
        """Return encoded observations, an array or several by name, and the next memory."""


class Encoded(torch.nn.Module):
    """A network of encoded observations, as a network of observations and memory, of which it may have some itself."""

    def __init__(self, encoder: Encoder, network: torch.nn.Module) -> None:
        super().__init__()
        self.encoder, self.network = encoder, network
        self.memory = {**encoder.memory, **getattr(network, "memory", {})}

    def forward(self, observation: Any, *memory: torch.Tensor) -> Any:
        """Return actions (n, ...) in [-1, 1], and the next memory if there is one."""
        count = len(self.encoder.memory)
        encoded, *encoders = self.encoder(observation, *memory[:count])
        result = self.network(encoded, *memory[count:])
        actions, *networks = result if isinstance(result, tuple) else (result,)
        return (actions, *encoders, *networks) if memory else actions
