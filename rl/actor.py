"""The actor that every learner trains: a torch module from observations to the environment's actions."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from armctl.agents import INPUT, OUTPUT, inputs
from armctl.envs import Sees
from armctl.rl.graph import write_graph
from armctl.tasks import Observations


class Actor(torch.nn.Module):
    """A network from observations to actions in [-1, 1], and their scaling to the environment's actions.

    It is also an `armctl.policies.Policy`, so that it can be evaluated while it learns.
    """

    sees: Sees = "observation"
    training_steps = 0

    def __init__(self, network: torch.nn.Module, scale: torch.nn.Module, observed: gymnasium.Space[Any]) -> None:
        super().__init__()
        self.network, self.scale = network, scale
        self.inputs = inputs(observed)

    def forward(self, *arrays: torch.Tensor) -> torch.Tensor:
        """Environment actions (n, ...) for observation arrays (n, ...), in the order of `inputs`."""
        observation: Any = arrays[0] if list(self.inputs) == [INPUT] else dict(zip(self.inputs, arrays, strict=True))
        return self.scale(observation, self.network(observation))

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Do nothing: the actor has no memory."""

    def act(self, observations: Observations) -> NDArray[np.float32]:
        """Actions (n, ...) for observations (n, ...)."""
        arrays = [observations[name] for name in self.inputs] if isinstance(observations, dict) else [observations]
        with torch.no_grad():
            return np.asarray(self(*map(torch.as_tensor, arrays)))

    def export(self, path: Path) -> None:
        """Write the actor as an ONNX graph with one input per observation array."""
        write_graph(self, examples(self.inputs), [OUTPUT], path)


def examples(inputs: Mapping[str, gymnasium.Space[Any]]) -> dict[str, torch.Tensor]:
    """Random observations of two worlds, by the names of a graph's inputs."""
    return {name: torch.as_tensor(np.asarray(space.sample())[None].repeat(2, 0)) for name, space in inputs.items()}


def tensors(observations: Any) -> Any:
    """Observations as tensors: one, or several by name."""
    if isinstance(observations, dict):
        return {name: torch.as_tensor(values) for name, values in observations.items()}
    return torch.as_tensor(observations)
