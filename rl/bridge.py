"""What makes the bridge learnable from its camera: inverse depth, and a car's range of commands.

Both are functions of the observation inside the exported graph: the agent sees and does what any policy may.
"""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

NEAR = 0.5
"""m: inverse depth is NEAR / (NEAR + depth)."""
LINEAR = (-0.3, 1.6)
"""m/s that the agent can command; 2.0 is what the rover can do."""
ANGULAR = (-2.0, 2.0)
"""rad/s."""


class BridgeFeatures(BaseFeaturesExtractor):
    """Inverse depths of all pixels, and own motion."""

    def __init__(self, observation_space: spaces.Dict, size: int = 128) -> None:
        super().__init__(observation_space, size + 3)
        image = observation_space["image"]
        assert isinstance(image, spaces.Box)
        self.image = torch.nn.Sequential(
            torch.nn.Flatten(), torch.nn.Linear(int(np.prod(image.shape)), size), torch.nn.ELU()
        )

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (n, size + 3) of images (n, height, width) and motions (n, 3)."""
        inverse = 2 * NEAR / (NEAR + observations["image"])
        return torch.cat((self.image(inverse), observations["motion"]), dim=1)


class VelocityScale(torch.nn.Module):
    """From the network's actions in [-1, 1] to linear and angular velocity."""

    def __init__(self) -> None:
        super().__init__()
        low, high = np.array((LINEAR, ANGULAR), dtype=np.float32).T
        self.register_buffer("middle", torch.as_tensor((low + high) / 2))
        self.register_buffer("span", torch.as_tensor((high - low) / 2))

    def forward(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """Environment actions (n, 2)."""
        return self.middle + self.span * actions.clamp(-1, 1)

    def inverse(self, observations: Any, actions: torch.Tensor) -> torch.Tensor:
        """The network's actions (n, 2), in [-1, 1], that come nearest to the environment's."""
        return ((actions - self.middle) / self.span).clamp(-1, 1)
