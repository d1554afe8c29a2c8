"""Flow matching of chunks of actions: a policy that draws its next actions from what a teacher would do.

A network learns to carry noise to the demonstrated actions along straight lines (Lipman et al., "Flow
matching for generative modeling", ICLR 2023). The policy plans a chunk of actions by a few Euler steps, executes its
first ones, and plans again (Chi et al., "Diffusion policy", RSS 2023; Black et al., "pi0", 2024). Where a teacher goes
left or right, the mean of both is not among what it plans from most latents.

A policy draws nothing: its flow begins at a latent that is part of the agent, the same in each control step, so that it
stays with a choice, and an episode is the same whenever it is played. See `FlowOptions.latent`.
"""

from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, options
from armctl.datasets.demonstrations import Demonstration
from armctl.rl.algorithms.bc import BcOptions, check_dataset
from armctl.rl.algorithms.cloning import fit_and_export
from armctl.rl.data.demonstrations import Examples, demonstrations
from armctl.rl.networks.actor import Actor, tensors
from armctl.rl.networks.flow import FlowNetwork
from armctl.rl.networks.view import Unscaled
from armctl.rl.run.learner import learner
from armctl.rl.run.training import Training

SAMPLES_OF_UNIT = 20_000
"""Examples from which mean and standard deviation of chunks are taken."""


@options
class FlowOptions(BcOptions):
    """Options of flow matching."""

    family = "flow matching"
    chunk: Count = 8
    """Control steps of a chunk."""
    executed: Count = 4
    """Control steps after which the next chunk is planned."""
    euler_steps: Count = 5
    """Steps from the latent to a chunk."""
    latent: Literal["zero", "drawn"] = "zero"
    """Beginning of the flow: the middle of the noise, where actions are most accurate, or a draw from it that depends
    on the training's seed."""

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


class FlowActor(Actor):
    """An actor that learns by flow matching."""

    def loss(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Return the mean squared error of the ends, at random times of the flow to chunks (n, length, k)."""
        return self.network.loss(observations, actions)


@learner(FlowOptions, rewards=False, curriculum=False, explores=False, check=check_dataset)
def train(training: Training, options: FlowOptions) -> AgentCard:
    """Fit a flow to the demonstrations."""
    examples = Chunks(training.held_out.task, options.chunk)
    examples.add(demonstrations(training, options, options.dataset))
    with training:
        return fit_and_export(training, new_flow(training, options, examples), examples, options.batch_size)


def new_flow(training: Training, options: FlowOptions, examples: Any) -> FlowActor:
    """Return an untrained actor, whose unit of actions is that of the examples."""
    torch.manual_seed(training.seed)
    view, space = training.view, training.held_out.single_observation_space
    observations, actions = map(tensors, examples.draw(np.random.default_rng(training.seed), SAMPLES_OF_UNIT))
    network = FlowNetwork(
        view.extractor(space), view.action_scale, observations, actions,
        executed=options.executed, euler_steps=options.euler_steps, hidden=[options.hidden_units] * options.layers,
    )  # fmt: skip
    if options.latent == "drawn":
        network.latent.normal_()
    return FlowActor(network, Unscaled(), space, network.memory)
