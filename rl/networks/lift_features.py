"""Features of the observation `paper` of `armctl/ArmLift-v0`: where the hand is, as the grasp sees it.

They are in the frame that turns with the arm's first joint, and tell the sides of the box in the hand's frame.
"""

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.rl.networks.layers import doubled, in_plane, object_motion, rotated
from armctl.scene import lift_table
from armctl.tasks.reach.observation import LENGTH_SCALE

SCALES = 0.05, 0.01
"""m: lengths that decide what to do next differ by so much; each is told on these scales too."""
FINE_TURN = 0.2
"""Sine of four times an angle: the same for the turn to the object's sides."""
DECISIVE, NUMBERS = 9, 17
"""Count of such lengths, and of further features beside the posture's."""


class LiftFeatures(BaseFeaturesExtractor):
    """Places of hand and object, heights and opening, the turn to the object's sides, and the posture."""

    def __init__(self, observation_space: spaces.Box, dof: int) -> None:
        super().__init__(observation_space, DECISIVE * (1 + len(SCALES)) + NUMBERS + 2 * (dof - 1))
        self.sizes = 3, dof, 1, 6, 1, 3, 2, 3

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (n, 44 + 2 (dof - 1)) of observations (n, 19 + dof)."""
        hand, joints, opening, axes, height, place, axis, velocity = observations.split(self.sizes, dim=1)
        yaw = joints[:, :1]
        hand, place = rotated(hand, -yaw), rotated(place, -yaw)
        offset = place - hand
        apart = offset[:, :2].square().sum(dim=1, keepdim=True).sqrt()
        heights = hand[:, 2:] - torch.tensor((lift_table.GRASP_HEIGHT, lift_table.APPROACH_HEIGHT))
        decisive = torch.cat(
            (offset, apart, heights, height - place[:, 2:], opening - lift_table.GRIPPED, opening - lift_table.OPENING),
            dim=1,
        )
        scaled = [LENGTH_SCALE * decisive, *((decisive / scale).tanh() for scale in SCALES)]
        axes = rotated(axes.unflatten(1, (2, 3)), -yaw[:, None]).flatten(1)
        turn = doubled(doubled(_turn(axes[:, 3:5], in_plane(axis, -yaw))))  # quarter turns are alike
        moving = object_motion(velocity, yaw)
        places = LENGTH_SCALE * torch.cat((hand, place[:, :2]), dim=1)
        posture = joints[:, 1:]
        turned = torch.cat((turn, (turn[:, 1:] / FINE_TURN).tanh()), dim=1)
        return torch.cat((*scaled, axes, turned, moving, places, posture.sin(), posture.cos()), dim=1)


def _turn(start: torch.Tensor, end: torch.Tensor) -> torch.Tensor:
    """Return cosine and sine (n, 2) of the turn from one direction (n, 2) to another."""
    cosine = (start * end).sum(dim=1, keepdim=True)
    return torch.cat((cosine, start[:, :1] * end[:, 1:] - start[:, 1:] * end[:, :1]), dim=1)
