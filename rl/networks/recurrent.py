"""A recurrent network, whose memory is the state of a gated recurrent unit (Cho et al., EMNLP 2014)."""

from collections.abc import Mapping
from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.core.errors import ConfigurationError
from armctl.rl.networks.layers import hidden_layers

MEMORY = "hidden"
"""Name of the memory."""
LAST_IMAGE = "last_image"
"""Name of the features of the last image that was not lost."""


def copy_weights(network: torch.nn.Module, weights: Mapping[str, torch.Tensor]) -> None:
    """Copy the weights of an agent that distil has trained to a network of the same sizes.

    Raises `ConfigurationError` if there are none for a parameter, or of another shape.
    """
    for name, parameter in network.named_parameters():
        values = weights.get(f"network.{name}")
        if values is None or values.shape != parameter.shape:
            raise ConfigurationError(
                f"the training starts from an agent as distil trains it, with weights network.{name} of shape "
                f"{tuple(parameter.shape)}: this one has none"
            )
        parameter.data.copy_(values)


class RecurrentNetwork(torch.nn.Module):
    """Features and an encoder, a gated recurrent unit, and layers from its state and the encoder to actions.

    Features that say how many of their first numbers are an image's, `image_size`, are those of the last image while
    images are lost: then all of these numbers are 1, the nearness of what touches the camera.
    """

    def __init__(
        self, features: BaseFeaturesExtractor, *, hidden_units: int, layers: int, memory_units: int, actions: int
    ) -> None:
        super().__init__()
        self.encoder = torch.nn.Sequential(
            features, torch.nn.Linear(features.features_dim, hidden_units), torch.nn.ReLU()
        )
        self.unit = torch.nn.GRUCell(hidden_units, memory_units)
        self.image_size: int = getattr(features, "image_size", 0)
        self.memory = {MEMORY: (memory_units,)} | ({LAST_IMAGE: (self.image_size,)} if self.image_size else {})
        sizes = [hidden_units + memory_units] + [hidden_units] * layers
        self.head = torch.nn.Sequential(*hidden_layers(sizes), torch.nn.Linear(sizes[-1], actions))

    def recall(
        self, observation: Any, hidden: torch.Tensor, *last_image: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, *tuple[torch.Tensor, ...]]:
        """Return what the head sees (n, j), and the next memory, for observations (n, ...) and the memory (n, m)."""
        features = self.encoder[0](observation)
        if self.image_size:
            image, rest = features[:, : self.image_size], features[:, self.image_size :]
            is_lost = (image >= 1).all(dim=1, keepdim=True)
            last_image = (torch.where(is_lost, last_image[0], image),)
            features = torch.cat((*last_image, rest), dim=1)
        encoded = self.encoder[1:](features)
        hidden = self.unit(encoded, hidden)
        return torch.cat((encoded, hidden), dim=1), hidden, *last_image

    def forward(
        self, observation: Any, *memory: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, *tuple[torch.Tensor, ...]]:
        """Return actions (n, k), mostly in [-1, 1], and the next memory, for observations (n, ...) and the memory."""
        recalled, *next_memory = self.recall(observation, *memory)
        return self.head(recalled), *next_memory
