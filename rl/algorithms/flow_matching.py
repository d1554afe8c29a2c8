"""Flow matching of chunks of actions: a policy that draws its next actions from what a teacher would do.

A network learns to carry noise to the demonstrated actions along straight lines (Lipman et al., "Flow
matching for generative modeling", ICLR 2023). The policy plans a chunk of actions by a few Euler steps, executes its
first ones, and plans again (Chi et al., "Diffusion policy", RSS 2023; Black et al., "pi0", 2024). Where a teacher goes
left or right, the mean of both is not among what it plans from most latents.

A policy draws nothing: its flow begins at a latent that is part of the agent, the same in each control step, so that it
stays with a choice, and an episode is the same whenever it is played. See `FlowOptions.latent`.
"""

from typing import Any, Literal

from armctl.agents import AgentCard
from armctl.core.options import Count, options
from armctl.rl.algorithms.bc import check_dataset
from armctl.rl.algorithms.chunking import ChunkOptions, fit_chunks
from armctl.rl.networks.flow import FlowNetwork
from armctl.rl.run.learner import learner
from armctl.rl.run.training import Training


@options
class FlowOptions(ChunkOptions):
    """Options of flow matching."""

    family = "flow matching"
    euler_steps: Count = 5
    """Steps from the latent to a chunk."""
    latent: Literal["zero", "drawn"] = "zero"
    """Beginning of the flow: the middle of the noise, where actions are most accurate, or a draw from it that depends
    on the training's seed."""


@learner(FlowOptions, rewards=False, curriculum=False, explores=False, check=check_dataset)
def train(training: Training, options: FlowOptions) -> AgentCard:
    """Fit a flow to the demonstrations."""

    def new_network(*args: Any, **sizes: Any) -> FlowNetwork:
        network = FlowNetwork(*args, **sizes)
        if options.latent == "drawn":
            network.latent.normal_()
        return network

    hidden = [options.hidden_units] * options.layers
    return fit_chunks(training, options, new_network, euler_steps=options.euler_steps, hidden=hidden)
