"""Options that learners share."""

from typing import ClassVar, Literal

from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, Positive, Share, options
from armctl.rl.networks.view import Features


@options
class TrainingOptions:
    """Options that all learners share."""

    family: ClassVar[str | None] = None
    """Kind of learning, for the agent's card."""
    steps: Count = 3_000_000
    """Environment steps, over all worlds."""
    worlds: Count = 256
    gamma: Share = 0.97
    """Discount factor."""
    learning_rate: Positive = 1e-3
    hidden_units: Count = 128
    """Units of each layer."""
    layers: Count = 2
    relative: bool = True
    """Reference of an arm's position commands: the observed joint positions, or else zero."""
    features: Features = "plain"
    """Input of the network: the bare observation (`none`), the task's features (`plain`), or features that are
    invariant under rotations of the scene (`invariant`), know the robot's geometry (`model`) or are hardly changed by
    sensor noise (`robust`), if the task has any."""
    evaluation_every: Count = 250_000
    """Steps between two evaluations on held-out episodes, each with a checkpoint."""
    validation_episodes: Count = 100
    """Episodes of each of these evaluations."""
    keeps: Literal["best", "last"] = "best"
    """Version that becomes the agent: the best one in these episodes, which have no disturbances, or the last one."""
    evaluation_episodes: Count = 1000
    """Development episodes of the final evaluation, which goes on the card."""


@options
class FrameOptions(TrainingOptions):
    """Options of learners whose networks may see earlier observations too."""

    frames: Count = 1
    """Observations that the network sees at once: the present one, and earlier ones."""
    frame_gap: Count = 1
    """Control steps from one of these observations to the next."""

    def __post_init__(self) -> None:
        if self.frame_gap > 1 and self.frames == 1:
            raise ConfigurationError("frame_gap is the time between frames, of which there is one: set frames too")
