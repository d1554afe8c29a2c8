"""What a task gives PPO: its settings, what the network is shown, how it acts, and the reward that it learns from."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.envs import TaskVectorEnv


@dataclass(frozen=True)
class PpoOptions:
    """Options of the learner."""

    steps: int = 3_000_000
    """Decisions in simulation, over all worlds."""
    worlds: int = 256
    rollout_length: int = 32
    """Decisions of each world between two updates."""
    batch_size: int = 2048
    epochs: int = 5
    learning_rate: float = 1e-3
    """Falls linearly to a twentieth."""
    gamma: float = 0.97
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    entropy: float = 0.0
    """Weight of the action distribution's entropy in the loss."""
    hidden_units: int = 128
    """In each of two layers."""
    initial_log_std: float = -0.5
    reward_scale: float = 0.02
    shaped: bool = True
    """Train with the recipe's shaped reward; evaluation is always on the task's own reward."""
    relative: bool = True
    """Position commands of an arm are relative to the observed joint positions, not absolute."""
    features: bool = True
    """The network is shown the recipe's features, not the bare observation."""
    checkpoint_every: int = 250_000
    """Steps between checkpoints, rounded up to whole rollouts."""
    evaluation_episodes: int = 1000


@dataclass(frozen=True)
class Recipe:
    """How PPO learns a task."""

    options: PpoOptions
    shaped: Mapping[str, Any]
    """Options of the environment that it trains in, where the reward is shaped."""
    features: type[BaseFeaturesExtractor]
    action_scale: Callable[[TaskVectorEnv, PpoOptions], torch.nn.Module]
    """Makes the map from observations and the network's actions in [-1, 1] to the environment's actions."""
