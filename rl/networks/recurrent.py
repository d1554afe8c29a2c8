"""A recurrent network, whose memory is the state of a gated recurrent unit (Cho et al., EMNLP 2014)."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.core.arrays import map_arrays
from armctl.core.errors import ConfigurationError
from armctl.rl.networks.layers import hidden_layers

MEMORY = "hidden"
"""Name of the memory."""
LAST_IMAGE = "last_image"
"""Name of the features of the last image that was not lost."""
UNIT = "unit.weight_ih"
"""Name of a parameter of the gated recurrent unit."""
WIDER = ("encoder.1.weight", "head.0.weight")
"""Names of weights that have more inputs than in a network without memory, the last ones."""
FEATURES = re.compile(r"encoder\.0\.(features\.)?")
"""Beginning of the names of the features' parameters."""


def copy_weights(network: torch.nn.Module, weights: Mapping[str, torch.Tensor]) -> None:
    """Copy the weights of an agent that armctl has trained to a network of the same sizes.

    A network with a memory takes those of one without, of layers of the same sizes, too: what is seen or remembered
    besides has no effect then. Raises `ConfigurationError` if there are none for a parameter, or of another shape.
    """
    has_unit = isinstance(network, RecurrentNetwork)
    names = _memoryless_names(network) if has_unit and f"network.{UNIT}" not in weights else {}
    for name, parameter in network.named_parameters():
        if names and name.startswith("unit."):
            continue
        values = _numbers(f"network.{names.get(name, name)}", parameter, weights)
        if names and name in WIDER and values is not None:
            unused = torch.zeros(len(values), max(0, parameter.shape[1] - values.shape[1]))
            values = torch.cat((values, unused), dim=1)
        if values is None or values.shape != parameter.shape:
            raise ConfigurationError(
                f"the training starts from an agent as distil trains it, with weights network.{name} of shape "
                f"{tuple(parameter.shape)}: this one has none"
            )
        parameter.data.copy_(values)


def _memoryless_names(network: torch.nn.Module) -> dict[str, str]:
    """Return the names of parameters in a sequence of features and layers, by those in a recurrent network."""
    names = [name for name, _ in network.named_parameters() if not name.startswith("unit.")]
    features = {name: FEATURES.sub("0.", name) for name in names if FEATURES.match(name)}
    layers = dict.fromkeys(name.rpartition(".")[0] for name in names if name not in features)
    numbers = {layer: 2 * i + 1 for i, layer in enumerate(layers)}  # a rectifier is behind each layer
    return features | {
        name: f"{numbers[name.rpartition('.')[0]]}.{name.rpartition('.')[2]}" for name in names if name not in features
    }


def _numbers(name: str, parameter: torch.Tensor, weights: Mapping[str, torch.Tensor]) -> torch.Tensor | None:
    """Return a parameter's numbers by its name, or, if the exported graph has them transposed, by its shape."""
    if name in weights or parameter.dim() != 2:
        return weights.get(name)
    transposed = [values for key, values in weights.items() if "." not in key and values.shape == parameter.shape[::-1]]
    return transposed[0].T if len(transposed) == 1 else None


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
        self._features_learn = any(True for _ in features.parameters())
        self.image_size: int = getattr(features, "image_size", 0)
        self.memory: dict[str, tuple[int, ...]] = {MEMORY: (memory_units,)} | (
            {LAST_IMAGE: (self.image_size,)} if self.image_size else {}
        )
        sizes = [hidden_units + memory_units] + [hidden_units] * layers
        self.head = torch.nn.Sequential(*hidden_layers(sizes), torch.nn.Linear(sizes[-1], actions))

    def recall(self, observation: Any, hidden: torch.Tensor, *last_image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return what the head sees (n, j), and the next memory, for observations (n, ...) and the memory (n, m)."""
        features, *next_image = self._features(observation, *last_image)
        encoded = self.encoder[1:](features)
        hidden = self.unit(encoded, hidden)
        return torch.cat((encoded, hidden), dim=1), hidden, *next_image

    def forward(self, observation: Any, *memory: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return actions (n, k), mostly in [-1, 1], and the next memory, for observations (n, ...) and the memory."""
        recalled, *next_memory = self.recall(observation, *memory)
        return self.head(recalled), *next_memory

    def inputs(self, observation: Any, *memory: torch.Tensor) -> Any:
        """Return the inputs (n, ...) of `replay` for observations (n, ...) and the memory: features without weights."""
        return observation if self._features_learn else self._features(observation, *memory[1:])[0]

    def replay(self, inputs: Sequence[Any], ongoing: Sequence[torch.Tensor], hidden: torch.Tensor) -> torch.Tensor:
        """Return the actions (t, n, k) of consecutive steps, for the inputs of each and the unit's state before them.

        All but the recurrent unit is computed in one batch. `ongoing` (n, 1) is False where the episode ends with the
        step: the next one has no memory.
        """
        steps, states = map_arrays(lambda *parts: torch.stack(parts), *inputs), []
        encoded = self._encode(map_arrays(lambda part: part.flatten(0, 1), steps)).unflatten(0, (len(inputs), -1))
        for step, goes_on in zip(encoded, ongoing, strict=True):
            states.append(self.unit(step, hidden))
            hidden = states[-1] * goes_on
        return self._actions(steps, self.head(torch.cat((encoded, torch.stack(states)), dim=2)))

    def _features(self, observation: Any, *last_image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return the features (n, k), and the features of the last image that was not lost, if they have any."""
        features = self.encoder[0](observation)
        if not self.image_size:
            return (features,)
        image, rest = features[:, : self.image_size], features[:, self.image_size :]
        is_lost = (image >= 1).all(dim=1, keepdim=True)
        image = torch.where(is_lost, last_image[0], image)
        return torch.cat((image, rest), dim=1), image

    def _encode(self, inputs: Any) -> torch.Tensor:
        """Return the encoder's outputs (n, k) for inputs of `replay`."""
        return self.encoder(inputs) if self._features_learn else self.encoder[1:](inputs)

    def _actions(self, inputs: Any, outputs: torch.Tensor) -> torch.Tensor:
        """Return the actions (t, n, k) for inputs of `replay` and the head's outputs."""
        return outputs

    def remember(self, memory: list[torch.Tensor], executed: torch.Tensor) -> list[torch.Tensor]:
        """Return the memory (n, ...) if `executed` (n, k) were the environment's actions instead of its own."""
        return memory

    def errors(self, actions: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Return the errors (n, k) of actions, which are to become small: squares."""
        return (actions - targets).square()
