"""Features of the observation `paper` of `armctl/ArmPush-v0`: where the tool is, as the push sees it.

They are in the frame that turns with the arm's first joint, and the line of the push from object to target.
"""

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.rl.networks.layers import doubled, in_plane, object_motion, rotated
from armctl.scene import push_table
from armctl.tasks.reach.observation import LENGTH_SCALE, NEARBY

FINE = 0.02
"""m: lengths that decide what to do next differ by so much; each is told on this scale too."""
NUMBERS = 35
"""Count of features beside the joints'."""


class PushFeatures(BaseFeaturesExtractor):
    """Places of tool, object and target, the line of the push and the tool's place beside it, and the posture."""

    def __init__(self, observation_space: spaces.Box, dof: int) -> None:
        super().__init__(observation_space, NUMBERS + 2 * (dof - 1))
        self.sizes = 3, dof, 3, 3, 2, 3

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (n, 35 + 2 (dof - 1)) of observations (n, 14 + dof)."""
        tool, joints, target, place, axis, velocity = observations.split(self.sizes, dim=1)
        yaw = joints[:, :1]
        tool, target, place = (rotated(point, -yaw) for point in (tool, target, place))
        to_target = (target - place)[:, :2]
        distance = _length(to_target)
        way = to_target / (distance + 1e-6)
        behind, offset = place[:, :2] - push_table.STAND_OFF * way, (tool - place)[:, :2]
        along = (offset * way).sum(dim=1, keepdim=True)
        across = offset[:, 1:] * way[:, :1] - offset[:, :1] * way[:, 1:]
        to_behind, height = behind - tool[:, :2], tool[:, 2:] - push_table.TOOL_HEIGHT
        apart = _length(to_behind)
        decisive = torch.cat((along, across, to_behind, apart, height, distance), dim=1)
        lengths = LENGTH_SCALE * torch.cat((tool, place[:, :2], target[:, :2], behind, decisive), dim=1)
        fine = (decisive / FINE).tanh()
        finest = torch.cat((height, distance, apart), dim=1) / NEARBY
        turn = doubled(in_plane(axis, -yaw))  # half turns are alike
        moving = object_motion(velocity, yaw)
        posture = joints[:, 1:]
        direction = to_behind / (apart + NEARBY)
        return torch.cat(
            (lengths, fine, finest.tanh(), way, direction, turn, moving, posture.sin(), posture.cos()), dim=1
        )


def _length(vectors: torch.Tensor) -> torch.Tensor:
    return vectors.square().sum(dim=1, keepdim=True).sqrt()
