"""A network that stands still at its target, whatever it has learned: it gives gains on errors that vanish there.

A network that gives actions is inexact everywhere, and so it also moves away from its target. Inexact gains are a
detour on the way there.
"""

from collections.abc import Sequence

import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.core.errors import ConfigurationError
from armctl.rl.networks.layers import hidden_layers


class GainNetwork(torch.nn.Module):
    """Actions (n, k) of observations: gains (n, k, e), which a network gives, times the features' errors (n, e).

    `hidden` are the sizes of the hidden layers. Raises `ConfigurationError` for features without `errors`.
    """

    def __init__(self, features: BaseFeaturesExtractor, hidden: Sequence[int], num_actions: int) -> None:
        super().__init__()
        num_errors = getattr(features, "num_errors", 0)
        if not num_errors:
            raise ConfigurationError("gains need features that vanish at the target: choose features = 'invariant'")
        self.features, self.shape = features, (num_actions, num_errors)
        sizes = [features.features_dim, *hidden]
        self.gains = torch.nn.Sequential(*hidden_layers(sizes), torch.nn.Linear(sizes[-1], num_actions * num_errors))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return actions (n, k)."""
        features = self.features(observations)
        gains = self.gains(features).unflatten(1, self.shape)
        return (gains * self.features.errors(features)[:, None]).sum(dim=2)
