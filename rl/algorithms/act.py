"""Action chunking with a transformer: ACT (Zhao et al., RSS 2023), small and from states.

The policy plans a chunk of actions from each observation that it uses, executes its first ones, and plans again. See
`armctl.rl.networks.chunking_transformer`.
"""

from armctl.agents import AgentCard
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, NonNegative, options
from armctl.rl.algorithms.bc import check_dataset
from armctl.rl.algorithms.chunking import ChunkOptions, fit_chunks
from armctl.rl.networks.chunking_transformer import HEADS, ChunkingTransformer
from armctl.rl.run.learner import learner
from armctl.rl.run.training import Training


@options
class ActOptions(ChunkOptions):
    """Options of ACT: `hidden_units` is the width of a token, `layers` the blocks of encoder and decoder."""

    family = "ACT"
    hidden_units: Count = 64
    layers: Count = 2
    style_weight: NonNegative = 10.0
    """Weight of the divergence of styles from their prior."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hidden_units % HEADS:
            raise ConfigurationError(f"hidden_units should be a multiple of {HEADS}, not {self.hidden_units}")


@learner(ActOptions, rewards=False, curriculum=False, explores=False, check=check_dataset)
def train(training: Training, options: ActOptions) -> AgentCard:
    """Fit a transformer to the demonstrations."""
    return fit_chunks(
        training, options, ChunkingTransformer,
        width=options.hidden_units, blocks=options.layers, style_weight=options.style_weight,
    )  # fmt: skip
