"""What makes the reach tasks learnable: what a network is shown of them, and how it acts.

Both are functions of the observation inside the exported graph: the agent sees and does what any policy may.
"""

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

LARGEST_MOVE = 0.5
"""rad that an action can command away from the present joint positions: a UR5 joint at its highest speed makes 0.126 in
one decision, and needs 0.33 to brake."""
LENGTH_SCALE = 2.0
"""1/m: brings the lengths of an arm's workspace to the order of one."""
NEARBY = 0.05
"""m from the target, below which its direction fades."""


class ReachFeatures(BaseFeaturesExtractor):
    """Observation (6 + dof + k,) as positions, the offset to the target, each joint's sine and cosine, and the rest."""

    def __init__(self, observation_space: spaces.Box, dof: int) -> None:
        self.parts = (3, dof, 3, observation_space.shape[0] - 6 - dof)
        super().__init__(observation_space, 13 + 2 * dof + self.parts[3])

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features (n, 13 + 2 dof + k) of observations (n, 6 + dof + k)."""
        end_effector, joints, target, rest = observations.split(self.parts, dim=1)
        offset = target - end_effector
        distance = offset.norm(dim=1, keepdim=True)
        direction = offset / (distance + NEARBY)
        lengths = LENGTH_SCALE * torch.cat((end_effector, target, offset, distance), dim=1)
        return torch.cat((lengths, direction, joints.sin(), joints.cos(), rest), dim=1)


class ActionScale(torch.nn.Module):
    """From the network's actions in [-1, 1] to the environment's, for each kind of control.

    Position commands are relative to the observed joint positions, unless `relative` is False. All else spans the
    action space, of absolute positions as much of it as is within half a turn.
    """

    def __init__(self, control: str, action_space: spaces.Box, relative: bool = True) -> None:
        super().__init__()
        self.relative = relative and control == "position"
        low, high = action_space.low, action_space.high
        if self.relative:
            low, high = np.full_like(low, -LARGEST_MOVE), np.full_like(high, LARGEST_MOVE)
        elif control == "position":
            low, high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
        self.register_buffer("middle", torch.as_tensor((low + high) / 2, dtype=torch.float32))
        self.register_buffer("span", torch.as_tensor((high - low) / 2, dtype=torch.float32))

    def forward(self, observations: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Environment actions (n, dof)."""
        move = self.middle + self.span * actions.clamp(-1, 1)
        return observations[:, 3 : 3 + len(self.span)] + move if self.relative else move
