"""Networks that plan chunks of actions, and the present chunk as a memory."""

from abc import ABC, abstractmethod
from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.rl.networks.layers import padded
from armctl.rl.networks.view import ActionScale

CHUNK, AGE = "chunk", "age"
"""Names of the memories: the actions of the present chunk that are still to come, and how many have been."""
SMALLEST_UNIT = 1e-3
"""Smallest standard deviation of actions that is taken for their unit."""


class ChunkNetwork(torch.nn.Module, ABC):
    """Maps observations (n, ...) to environment actions (n, k), which are the next of a chunk.

    The `actions` (m, length, k) and `observations` of examples give the unit of chunks. If the `scale` of actions is
    relative to a part of the observation, chunks are relative to it when they are planned, and no move is larger than
    the scale's for each control step. Every `executed` steps, a chunk is planned anew.
    """

    lowest: torch.Tensor
    highest: torch.Tensor
    mean: torch.Tensor
    unit: torch.Tensor

    def __init__(
        self,
        features: BaseFeaturesExtractor,
        scale: ActionScale,
        observations: Any,
        actions: torch.Tensor,
        *,
        executed: int,
    ) -> None:
        super().__init__()
        self._relative_to, self._executed = scale.relative_to, executed
        self.features = features
        _, self.length, self.count = actions.shape
        self.memory = {CHUNK: (executed * self.count,), AGE: (1,)} if executed > 1 else {}
        steps = torch.arange(1.0, self.length + 1)[:, None]
        steps = steps if self._relative_to is not None else torch.ones_like(steps)
        self.register_buffer("lowest", scale.middle - steps * scale.span)
        self.register_buffer("highest", scale.middle + steps * scale.span)
        chunks = self._moves(observations, actions)
        self.register_buffer("mean", chunks.mean(dim=0))
        self.register_buffer("unit", chunks.std(dim=0).clamp(min=SMALLEST_UNIT))

    def loss(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return the loss for demonstrated chunks (n, length, k) of environment actions."""
        return self.error(observations, (self._moves(observations, actions) - self.mean) / self.unit)

    @abstractmethod
    def error(self, observations: Any, chunks: torch.Tensor) -> torch.Tensor:
        """Return the loss for demonstrated chunks (n, length * k), in units of their standard deviation."""

    @abstractmethod
    def planned(self, observations: Any) -> torch.Tensor:
        """Return chunks (n, length * k), in units of their standard deviation."""

    def plan(self, observations: Any) -> torch.Tensor:
        """Return chunks (n, length, k) of environment actions."""
        chunks = self.mean + self.unit * self.planned(observations)
        return self._base(observations) + chunks.unflatten(1, (-1, self.count))

    def forward(self, observations: Any, *memory: torch.Tensor) -> Any:
        """Return actions (n, k), and the next memory if there is one."""
        planned = self.plan(observations)
        if not memory:
            return planned[:, 0]
        chunk, age = memory
        chunk = torch.where(age == 0, planned[:, : self._executed].flatten(1), chunk)
        action, later = chunk[:, : self.count], chunk[:, self.count :]
        age = torch.where(age + 1 == self._executed, torch.zeros_like(age), age + 1)
        return action, torch.cat((later, action), dim=1), age

    def _moves(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return chunks (n, length * k) relative to the observations."""
        return (actions - self._base(observations)).clamp(self.lowest, self.highest).flatten(1)

    def _base(self, observations: Any) -> Any:
        """Return what chunks are relative to, (n, 1, k) or 0."""
        return 0.0 if self._relative_to is None else padded(observations[:, self._relative_to], self.count)[:, None]
