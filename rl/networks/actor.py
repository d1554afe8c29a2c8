"""The actor that every learner trains: a torch module from observations to the environment's actions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from armctl.agents import inputs
from armctl.core.arrays import Observations, map_arrays
from armctl.envs import Sees
from armctl.rl.networks.onnx_graph import initial_memory, observation_of, write_graph

SMALL_DISTANCE = 0.03
"""Distance from a label, in the network's unit, below which the loss of a `MedianActor` becomes quadratic."""


class Actor(torch.nn.Module):
    """A network from observations to actions in [-1, 1], and their scaling to the environment's actions.

    A network with `memory` (shapes of arrays of each world, by name) maps observations and these arrays to actions and
    the arrays of the next control step. At an episode's beginning, they are zeros.

    It is also an `armctl.policies.Policy`, so that it can be evaluated while it learns.
    """

    sees: Sees = "observation"
    training_steps = 0

    def __init__(
        self,
        network: torch.nn.Module,
        scale: torch.nn.Module,
        observation_space: gymnasium.Space[Any],
        memory: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        super().__init__()
        self.network, self.scale = network, scale
        self.inputs, self.memory = inputs(observation_space), dict(memory or {})
        self._remembered = initial_memory(self.memory, 0)

    def forward(self, *arrays: torch.Tensor) -> Any:
        """Return environment actions (n, ...), and the next memory if there is one.

        `arrays` (n, ...) are those of the observation, in the order of `inputs`, and of the memory.
        """
        observation = observation_of(self.inputs, arrays[: len(self.inputs)])
        if not self.memory:
            return self.scale(observation, self.network(observation))
        actions, *next_memory = self.network(observation, *arrays[len(self.inputs) :])
        return self.scale(observation, actions), *next_memory

    def loss(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return the mean squared error for environment actions (n, ...), in the network's unit."""
        return (self.network(observations) - self.scale.inverse(observations, actions)).square().mean()

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Forget what it remembers of worlds `ids`, if it has a memory."""
        for remembered in self._remembered:
            remembered[ids[ids < len(remembered)]] = 0.0

    def act(self, observations: Observations) -> NDArray[np.float32]:
        """Return actions (n, ...) for observations (n, ...). With another number of worlds, the memory is empty."""
        arrays = [observations[name] for name in self.inputs] if isinstance(observations, dict) else [observations]
        num_envs = len(arrays[0])
        if any(len(remembered) != num_envs for remembered in self._remembered):
            self._remembered = initial_memory(self.memory, num_envs)
        with torch.no_grad():
            actions = self(*map(torch.as_tensor, arrays), *self._remembered)
        if self.memory:
            actions, *self._remembered = actions
        return np.asarray(actions)

    def export(self, path: Path) -> None:
        """Write the actor as an ONNX graph with one input for each array of the observation and of the memory."""
        write_graph(self, self.inputs, self.memory, path)


class EncodedActor(Actor):
    """An actor whose features have no weights, so that examples are features, and actions in the network's unit."""

    @property
    def num_features(self) -> int:
        """Number of features."""
        return int(self.network[0].features_dim)

    def encoded(
        self, observations: NDArray[np.float32], actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the features (n, `num_features`) of observations, and environment actions (n, k) in its own unit."""
        with torch.no_grad():
            inputs = torch.as_tensor(observations)
            return self.network[0](inputs).numpy(), self.scale.inverse(inputs, torch.as_tensor(actions)).numpy()

    def loss(self, features: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Return the mean squared error for `encoded` examples."""
        return (self.network[1:](features.float()) - actions).square().mean()


class MedianActor(Actor):
    """An actor whose loss is the distance from labels, not its square: its minimum is their geometric median.

    Where a teacher changes from one way to another, the mean of its labels is no way at all, and the student stands
    still there. The median is the more frequent way.
    """

    def loss(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return the mean distance from environment actions (n, ...), in the network's unit.

        Outputs beyond the bound at which a label is have no error: both are the same action.
        """
        outputs, labels = self.network(observations), self.scale.inverse(observations, actions)
        is_same = (labels.abs() >= 1) & (labels * outputs >= 1)
        squares = (outputs - labels).square().masked_fill(is_same, 0.0).sum(dim=1)
        return (squares + SMALL_DISTANCE**2).sqrt().mean()


def tensors(observations: Any) -> Any:
    """Return observations as tensors: one, or several by name."""
    return map_arrays(torch.as_tensor, observations)


def numpy_arrays(observations: Any) -> Any:
    """Return tensors as NumPy arrays: one, or several by name."""
    return map_arrays(torch.Tensor.numpy, observations)
