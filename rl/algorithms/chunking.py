"""Shared by learners of chunks of actions: options, examples, and the actor."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, options
from armctl.datasets.demonstrations import Demonstration
from armctl.rl.algorithms.bc import BcOptions
from armctl.rl.algorithms.cloning import fit_and_export
from armctl.rl.data.demonstrations import Examples, demonstrations
from armctl.rl.networks.actor import Actor, tensors
from armctl.rl.networks.chunks import ChunkNetwork
from armctl.rl.networks.view import Unscaled
from armctl.rl.run.training import Training

SAMPLES_OF_UNIT = 20_000
"""Examples from which mean and standard deviation of chunks are taken."""


@options
class ChunkOptions(BcOptions):
    """Options of learners of chunks."""

    chunk: Count = 8
    """Control steps of a chunk."""
    executed: Count = 4
    """Control steps after which the next chunk is planned."""

    def __post_init__(self) -> None:
        if self.executed > self.chunk:
            raise ConfigurationError(f"of a chunk of {self.chunk} control steps, {self.executed} cannot be executed")


class Chunks(Examples):
    """Demonstrations whose examples are chunks of the next actions; an episode's last action is repeated."""

    def __init__(self, task: Any, length: int) -> None:
        super().__init__(task, hindsight=0.0)
        self._steps = np.arange(length)

    def add(self, episodes: list[Demonstration]) -> None:
        """Add episodes."""
        super().add(episodes)
        lengths = [len(episode) for episode in self.episodes]
        self._last = np.repeat(np.cumsum(lengths) - 1, lengths)

    def actions_of(self, samples: NDArray[np.intp]) -> NDArray[np.float32]:
        """Return the chunks (size, length, k) that begin at these samples."""
        return self._actions[np.minimum(samples[:, None] + self._steps, self._last[samples, None])]


class ChunkActor(Actor):
    """An actor whose network plans chunks."""

    def loss(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return the network's loss for chunks (n, length, k) of environment actions."""
        return self.network.loss(observations, actions)


def fit_chunks(
    training: Training, options: ChunkOptions, new_network: Callable[..., ChunkNetwork], **sizes: Any
) -> AgentCard:
    """Fit `new_network`, made with features, scale, examples and `sizes`, to the chunks of demonstrations."""
    examples = Chunks(training.held_out.task, options.chunk)
    examples.add(demonstrations(training, options, options.dataset))
    with training:
        torch.manual_seed(training.seed)
        view, space = training.view, training.held_out.single_observation_space
        observations, actions = map(tensors, examples.draw(np.random.default_rng(training.seed), SAMPLES_OF_UNIT))
        network = new_network(
            view.extractor(space), view.action_scale, observations, actions, executed=options.executed, **sizes
        )
        return fit_and_export(
            training, ChunkActor(network, Unscaled(), space, network.memory), examples, options.batch_size
        )
