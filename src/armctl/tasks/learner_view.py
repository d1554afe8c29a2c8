"""Input and output of a network for a task: features and relative actions, as plain values."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class FeatureSpec:
    """A feature extractor for networks: a name from `rl/networks/features.py` or `module:Class`, and its options."""

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    prepare: str | None = None
    """A name from `rl/networks/features.py` or `module:Class`, of a network module that is made with the observation
    space and `prepare_options`. It maps observations (n, ...) to smaller ones: an array, or several by name. The
    features are of these, and so are buffers and the memory of agents."""
    prepare_options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class LearnerView:
    """Features and relative actions for learners, as plain values from which they build networks."""

    relative_to: slice | None = None
    """The part of the observation that the first actions, as many, may be relative to, if any."""
    largest_move: float = 0.0
    """Bound on each component of a relative action."""
    features: FeatureSpec | None = None
    """None: the bare observation."""
    invariant_features: FeatureSpec | None = None
    """Features that are invariant under the task's symmetries, if it has any."""
    model_features: FeatureSpec | None = None
    """Features that know the robot's geometry, if there are any: an agent with them sees the robot's model."""
    robust_features: FeatureSpec | None = None
    """Features that noise and lost images hardly change, if there are any."""
    state_features: FeatureSpec | None = None
    """Function of the state for a privileged critic, without `prepare`; None: its numbers as shares of their bounds."""
