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
BOX_NUMBERS = 7
"""That tell a box: see `armctl.tasks.reach_obstacles`."""
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


class TurnedFeatures(BaseFeaturesExtractor):
    """The same in the frame of an arm's first joint, whose axis is vertical: turning all about it changes nothing.

    `parts` are the names and sizes of the observation's parts from the joint positions on. The velocity of a target is
    turned as well, and so are boxes, of which each is seen by the same small network, and the largest answers are kept
    (Qi et al., PointNet, 2017): their order does not matter.
    """

    def __init__(self, observation_space: spaces.Box, dof: int, parts: dict[str, int], box_features: int = 64) -> None:
        self.sizes = dict(parts)
        boxed = "boxes" in parts
        rest = sum(size for name, size in parts.items() if name != "boxes") + (box_features if boxed else 0)
        super().__init__(observation_space, 13 + 2 * (dof - 1) + rest)
        self.dof = dof
        if boxed:
            self.boxes = torch.nn.Sequential(
                torch.nn.Linear(BOX_NUMBERS + 4, box_features),
                torch.nn.ReLU(),
                torch.nn.Linear(box_features, box_features),
                torch.nn.ReLU(),
            )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features (n, k) of observations (n, 6 + dof + rest)."""
        tip, joints, target, *rest = observations.split((3, self.dof, 3, *self.sizes.values()), dim=1)
        turn = joints[:, :1]
        tip, target = turned(tip, -turn), turned(target, -turn)
        offset = target - tip
        distance = offset.norm(dim=1, keepdim=True)
        lengths = LENGTH_SCALE * torch.cat((tip, target, offset, distance), dim=1)
        seen = [lengths, offset / (distance + NEARBY), joints[:, 1:].sin(), joints[:, 1:].cos()]
        for name, part in zip(self.sizes, rest, strict=True):
            if name == "boxes":
                seen.append(self._see_boxes(part, turn, target))
            else:
                seen.append(turned(part, -turn) if name == "target_velocity" else part)
        return torch.cat(seen, dim=1)

    def _see_boxes(self, numbers: torch.Tensor, turn: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        boxes = numbers.unflatten(1, (-1, BOX_NUMBERS))
        turn = turn[:, None]
        centre, half_sizes = turned(boxes[..., :3], -turn), boxes[..., 3:6]
        yaw = 2 * (boxes[..., 6:] - turn)  # a box that has been turned by pi is the same
        parts = (centre, centre - target[:, None], half_sizes, yaw.sin(), yaw.cos())
        there = (half_sizes > 0).all(dim=-1, keepdim=True)
        return (self.boxes(LENGTH_SCALE * torch.cat(parts, dim=-1)) * there).amax(dim=1)


def turned(vectors: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """Vectors (..., 3) turned about the vertical by angles (..., 1), rad."""
    x, y, z = vectors.split(1, dim=-1)
    return torch.cat((angles.cos() * x - angles.sin() * y, angles.sin() * x + angles.cos() * y, z), dim=-1)


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

    def inverse(self, observations: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """The network's actions (n, dof), in [-1, 1], that come nearest to the environment's."""
        move = actions - observations[:, 3 : 3 + len(self.span)] if self.relative else actions
        return ((move - self.middle) / self.span).clamp(-1, 1)
