"""Features of an arm among boxes that know its geometry: where its links are, as each box sees them.

Forward kinematics is part of the network's graph. Points along the links are put into each box's frame, with their
offsets beyond the box's faces and their distances from it. A small network encodes each box, and max pooling makes the
result independent of their order (Qi et al., PointNet, 2017). Rotating the scene about the vertical changes nothing.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.core.errors import ConfigurationError
from armctl.rl.networks.layers import LinkPoints, hidden_layers, in_first_joint_frame, length, rotated
from armctl.scene import BOX_NUMBERS
from armctl.tasks.reach import observation_sizes
from armctl.tasks.reach.observation import LENGTH_SCALE, NEARBY

POINT_NUMBERS = 8
"""Count for a point and a box: place and offset beyond the faces (3 each), distance, nearness."""
NUMBERS_PER_BOX = 14
"""Count for a box: half sizes, centre, target's place and offset (3 each), sine and cosine of its turn."""
PLAIN_NUMBERS = 13
"""Count besides: positions of the end-effector and the target, offset and direction (3 each), and distance."""


class LinkBoxFeatures(BaseFeaturesExtractor):
    """Features of the observation `paper` of a task with boxes, which end it.

    `geometry` is what `ArmModel.geometry` says of the arm, whose first joint turns about the vertical.
    """

    def __init__(
        self, observation_space: spaces.Box, geometry: Mapping[str, Sequence[Any]], box_features: int = 96
    ) -> None:
        links = LinkPoints(geometry)
        sizes = observation_sizes(links.dof).values()
        boxes = observation_space.shape[0] - sum(sizes)
        if boxes <= 0 or boxes % BOX_NUMBERS:
            raise ConfigurationError("these features are for an observation that ends with the boxes")
        super().__init__(observation_space, PLAIN_NUMBERS + 2 * (links.dof - 1) + box_features)
        self.links, self.sizes = links, [*sizes, boxes]
        box_inputs = len(links.radii) * POINT_NUMBERS + NUMBERS_PER_BOX
        self.boxes = torch.nn.Sequential(*hidden_layers((box_inputs, box_features, box_features)))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (n, k) of observations (n, 6 + dof + boxes)."""
        tip, joints, target, numbers = observations.split(self.sizes, dim=1)
        yaw = joints[:, :1]
        features, target = in_first_joint_frame(tip, joints, yaw, target, length)
        boxes = numbers.unflatten(1, (-1, BOX_NUMBERS))
        without_yaw = torch.cat((torch.zeros_like(yaw), joints[:, 1:]), dim=1)
        return torch.cat((*features, self._encode(boxes, yaw, target, self.links(without_yaw))), dim=1)

    def _encode(
        self, boxes: torch.Tensor, base_yaw: torch.Tensor, target: torch.Tensor, points: torch.Tensor
    ) -> torch.Tensor:
        present = (boxes[..., 3:6] > 0).all(dim=-1)
        if torch.compiler.is_exporting():  # a graph of one shape
            encoded = self._encode_each(boxes, base_yaw, target, points) * present[..., None]
        else:  # two thirds of the boxes are absent
            worlds, slots = present.nonzero(as_tuple=True)
            among = (boxes[worlds, slots][:, None], base_yaw[worlds], target[worlds], points[worlds])
            encoded = points.new_zeros(*present.shape, self.boxes[-2].out_features)
            encoded[worlds, slots] = self._encode_each(*among)[:, 0]
        return encoded.amax(dim=1)

    def _encode_each(
        self, boxes: torch.Tensor, base_yaw: torch.Tensor, target: torch.Tensor, points: torch.Tensor
    ) -> torch.Tensor:
        """Return each box's features (n, boxes, k)."""
        centre, half_sizes = rotated(boxes[..., :3], -base_yaw[:, None]), boxes[..., 3:6]
        yaw = boxes[..., 6:] - base_yaw[:, None]
        yaw = yaw - math.pi * (yaw / math.pi).round()  # a box rotated by pi is the same
        points_seen = self.seen_from(points, centre, half_sizes, yaw, self.links.radii)
        aim = self.seen_from(target[:, None], centre, half_sizes, yaw, torch.zeros_like(self.links.radii[:1]))
        of_box = (LENGTH_SCALE * half_sizes, LENGTH_SCALE * centre, aim[..., 0, :6], yaw.sin(), yaw.cos())
        return self.boxes(torch.cat((points_seen.flatten(2), *of_box), dim=-1))

    @staticmethod
    def seen_from(
        points: torch.Tensor, centre: torch.Tensor, half_sizes: torch.Tensor, yaw: torch.Tensor, radii: torch.Tensor
    ) -> torch.Tensor:
        """Return points (n, p, 3) as boxes see them, (n, boxes, p, `POINT_NUMBERS`).

        `centre` and `half_sizes` are (n, boxes, 3) m, `yaw` is (n, boxes, 1) rad. Balls of `radii` (p,) m are around
        points.
        """
        local = rotated(points[:, None] - centre[:, :, None], -yaw[:, :, None])
        beyond = local.abs() - half_sizes[:, :, None]
        distance = length(beyond.relu()) - radii[:, None]
        nearness = NEARBY / (NEARBY + distance.relu())
        return torch.cat((LENGTH_SCALE * torch.cat((local, beyond, distance), dim=-1), nearness), dim=-1)
