"""The network of a flow-matching policy: a flow over chunks of actions, and the present chunk as a memory.

It predicts where the flow ends, from which the velocity follows: (end - place) / (1 - time). The velocity itself has
the noise in it, which a small network passes on with errors that are larger than the accuracy that actions need.
"""

from collections.abc import Sequence
from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.rl.networks.layers import hidden_layers, padded
from armctl.rl.networks.view import ActionScale

CHUNK, AGE = "chunk", "age"
"""Names of the memories: the actions of the present chunk that are still to come, and how many have been."""
FREQUENCIES = 4
"""Count of frequencies by which the network is told the time of the flow."""
SMALLEST_UNIT = 1e-3
"""Smallest standard deviation of actions that is taken for their unit."""


class FlowNetwork(torch.nn.Module):
    """Maps observations (n, ...) to environment actions (n, k), which are the next of a chunk.

    The `actions` (m, length, k) and `observations` of examples give the unit of chunks. If the `scale` of actions is
    relative to a part of the observation, chunks are relative to it when they are planned, and no move is larger than
    the scale's for each control step. Every `executed` steps, a chunk is planned anew, by `euler_steps` steps
    along the flow from `latent` (length * k,).
    """

    latent: torch.Tensor
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
        euler_steps: int,
        hidden: Sequence[int],
    ) -> None:
        super().__init__()
        self._relative_to, self._executed, self._euler_steps = scale.relative_to, executed, euler_steps
        _, length, self._count = actions.shape
        size = length * self._count
        self.features = features
        self.ends = torch.nn.Sequential(
            *hidden_layers([features.features_dim + size + 2 * FREQUENCIES, *hidden]), torch.nn.Linear(hidden[-1], size)
        )
        self.memory = {CHUNK: (executed * self._count,), AGE: (1,)} if executed > 1 else {}
        steps = torch.arange(1.0, length + 1)[:, None] if self._relative_to is not None else torch.ones(length, 1)
        self.register_buffer("lowest", scale.middle - steps * scale.span)
        self.register_buffer("highest", scale.middle + steps * scale.span)
        chunks = self._moves(observations, actions)
        self.register_buffer("latent", torch.zeros(size))
        self.register_buffer("mean", chunks.mean(dim=0))
        self.register_buffer("unit", chunks.std(dim=0).clamp(min=SMALLEST_UNIT))
        self.register_buffer("frequencies", torch.pi * 2.0 ** torch.arange(FREQUENCIES))

    def loss(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return the mean squared error of the ends, at random times of the flow to chunks (n, length, k)."""
        ends = (self._moves(observations, actions) - self.mean) / self.unit
        begins, times = torch.randn_like(ends), torch.rand(len(ends), 1)
        places = begins + times * (ends - begins)
        return (self._ends(self.features(observations), places, times) - ends).square().mean()

    def plan(self, observations: Any) -> torch.Tensor:
        """Return chunks (n, length, k) of environment actions."""
        features = self.features(observations)
        places = self.latent + torch.zeros_like(features[:, :1])
        for step in range(self._euler_steps):
            times = torch.full_like(features[:, :1], step / self._euler_steps)
            velocity = (self._ends(features, places, times) - places) / (1 - times)
            places = places + velocity / self._euler_steps
        return self._base(observations) + (self.mean + self.unit * places).unflatten(1, (-1, self._count))

    def forward(self, observations: Any, *memory: torch.Tensor) -> Any:
        """Return actions (n, k), and the next memory if there is one."""
        planned = self.plan(observations)
        if not memory:
            return planned[:, 0]
        chunk, age = memory
        chunk = torch.where(age == 0, planned[:, : self._executed].flatten(1), chunk)
        action, later = chunk[:, : self._count], chunk[:, self._count :]
        age = torch.where(age + 1 == self._executed, torch.zeros_like(age), age + 1)
        return action, torch.cat((later, action), dim=1), age

    def _ends(self, features: torch.Tensor, places: torch.Tensor, times: torch.Tensor) -> torch.Tensor:
        waves = times * self.frequencies
        return self.ends(torch.cat((features, places, waves.sin(), waves.cos()), dim=1))

    def _moves(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return chunks (n, length * k) relative to the observations."""
        return (actions - self._base(observations)).clamp(self.lowest, self.highest).flatten(1)

    def _base(self, observations: Any) -> Any:
        """Return what chunks are relative to, (n, 1, k) or 0."""
        return 0.0 if self._relative_to is None else padded(observations[:, self._relative_to], self._count)[:, None]
