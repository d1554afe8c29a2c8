"""The actor that every learner trains: a torch module from observations to the environment's actions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from armctl.agents import INPUT, NEXT, OUTPUT, inputs
from armctl.envs import Sees
from armctl.rl.graph import write_graph
from armctl.tasks import Observations


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
        observed: gymnasium.Space[Any],
        memory: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        super().__init__()
        self.network, self.scale = network, scale
        self.inputs, self.memory = inputs(observed), dict(memory or {})
        self._remembered = blank(self.memory, 0)

    def forward(self, *arrays: torch.Tensor) -> Any:
        """Environment actions (n, ...), and the next memory if there is one.

        `arrays` (n, ...) are those of the observation, in the order of `inputs`, and of the memory.
        """
        seen, remembered = arrays[: len(self.inputs)], arrays[len(self.inputs) :]
        observation: Any = seen[0] if list(self.inputs) == [INPUT] else dict(zip(self.inputs, seen, strict=True))
        if not self.memory:
            return self.scale(observation, self.network(observation))
        actions, *after = self.network(observation, *remembered)
        return self.scale(observation, actions), *after

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Forget what it remembers of worlds `ids`, if it has a memory."""
        for remembered in self._remembered:
            remembered[ids[ids < len(remembered)]] = 0.0

    def act(self, observations: Observations) -> NDArray[np.float32]:
        """Actions (n, ...) for observations (n, ...). For another number of worlds than before, it begins anew."""
        arrays = [observations[name] for name in self.inputs] if isinstance(observations, dict) else [observations]
        worlds = len(arrays[0])
        if any(len(remembered) != worlds for remembered in self._remembered):
            self._remembered = blank(self.memory, worlds)
        with torch.no_grad():
            actions = self(*map(torch.as_tensor, arrays), *self._remembered)
        if self.memory:
            actions, *self._remembered = actions
        return np.asarray(actions)

    def export(self, path: Path) -> None:
        """Write the actor as an ONNX graph with one input for each array of the observation and of the memory."""
        remembered = dict(zip(self.memory, blank(self.memory, 2), strict=True))
        write_graph(self, examples(self.inputs) | remembered, [OUTPUT, *(NEXT + name for name in self.memory)], path)


def blank(memory: Mapping[str, Sequence[int]], worlds: int) -> list[torch.Tensor]:
    """What is remembered at the beginning of episodes in so many worlds: zeros (n, ...)."""
    return [torch.zeros(worlds, *shape) for shape in memory.values()]


def examples(inputs: Mapping[str, gymnasium.Space[Any]]) -> dict[str, torch.Tensor]:
    """Random observations of two worlds, by the names of a graph's inputs."""
    return {name: torch.as_tensor(np.asarray(space.sample())[None].repeat(2, 0)) for name, space in inputs.items()}


def tensors(observations: Any) -> Any:
    """Observations as tensors: one, or several by name."""
    if isinstance(observations, dict):
        return {name: torch.as_tensor(values) for name, values in observations.items()}
    return torch.as_tensor(observations)
