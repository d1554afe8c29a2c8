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
from armctl.rl.networks.layers import (
    TURN_NUMBERS,
    frame_of,
    hidden_layers,
    in_first_joint_frame,
    joint_frames,
    missing_turn,
    rotated,
)
from armctl.scene import BOX_NUMBERS
from armctl.tasks.reach import observation_sizes
from armctl.tasks.reach.observation import LENGTH_SCALE, NEARBY

POINT_NUMBERS = 8
"""Count for a point and a box: place and offset beyond the faces (3 each), distance, nearness."""
NUMBERS_PER_BOX = 14
"""Count for a box: half sizes, centre, target's place and offset (3 each), sine and cosine of its turn."""
TILT_NUMBERS = 2
"""Count for a box that may be tilted, besides: sine and cosine of its tilt."""
PLAIN_NUMBERS = 13
"""Count besides: positions of the end-effector and the target, offset and direction (3 each), and distance."""
APPROACH_SCALES = 0.1, 0.02
"""m: the way to a pose counts on these scales too, since the hand has to fit between things there."""
POSE_NUMBERS = 12 + TURN_NUMBERS + 3 * (1 + len(APPROACH_SCALES))
"""Count for a target that is a pose: axes of end-effector and target, the turn, and the way in the target's frame."""


class LinkBoxFeatures(BaseFeaturesExtractor):
    """Features of the observation `paper` of a task with boxes, which end it; with `poses`, axes are before them.

    `geometry` is what `ArmModel.geometry` says of the arm, whose first joint turns about the vertical. A box has
    `box_numbers`, `BOX_NUMBERS` or `TILTED_BOX_NUMBERS`.
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        geometry: Mapping[str, Sequence[Any]],
        box_numbers: int = BOX_NUMBERS,
        poses: bool = False,
        box_features: int = 96,
    ) -> None:
        turns = torch.tensor([geometry["base"], geometry["sine"], geometry["versine"]])
        dof = turns.shape[1]
        sizes = [*observation_sizes(dof).values(), 12 * poses]
        boxes = observation_space.shape[0] - sum(sizes)
        if boxes <= 0 or boxes % box_numbers:
            raise ConfigurationError("these features are for an observation that ends with the boxes")
        super().__init__(observation_space, PLAIN_NUMBERS + 2 * (dof - 1) + POSE_NUMBERS * poses + box_features)
        self.sizes, self.box_numbers, self.poses = [*sizes, boxes], box_numbers, poses
        self.points_of = [[i for i, moved_by in enumerate(geometry["joint"]) if moved_by == k + 1] for k in range(dof)]
        self.register_buffer("turns", turns)
        self.register_buffer("offsets", torch.tensor(geometry["offset"]))
        order = [i for points in self.points_of for i in points]
        self.register_buffer("points", torch.tensor(geometry["points"])[order])
        self.register_buffer("radii", torch.tensor(geometry["radii"])[order])
        box_inputs = len(order) * POINT_NUMBERS + NUMBERS_PER_BOX + TILT_NUMBERS * (box_numbers > BOX_NUMBERS)
        self.boxes = torch.nn.Sequential(*hidden_layers((box_inputs, box_features, box_features)))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (n, k) of observations (n, 6 + dof + boxes), or with poses (n, 18 + dof + boxes)."""
        tip, joints, target, axes, numbers = observations.split(self.sizes, dim=1)
        yaw = joints[:, :1]
        features, target = in_first_joint_frame(tip, joints, yaw, target, length)
        if self.poses:
            axes = rotated(axes.unflatten(1, (4, 3)), -yaw[:, None])
            features.append(_pose_features(rotated(tip, -yaw) - target, axes))
        boxes = numbers.unflatten(1, (-1, self.box_numbers))
        return torch.cat((*features, self._encode(boxes, yaw, target, self.link_points(joints))), dim=1)

    def link_points(self, joints: torch.Tensor) -> torch.Tensor:
        """Return points (n, p, 3) m along the links, in the first joint's frame, at `joints` (n, dof)."""
        placed, first = [], 0
        without_yaw = torch.cat((torch.zeros_like(joints[:, :1]), joints[:, 1:]), dim=1)
        frames = joint_frames(self.turns, self.offsets, without_yaw)
        for points, (rotation, origin) in zip(self.points_of, frames, strict=True):
            if points:
                local = self.points[first : first + len(points)]
                placed.append(origin[:, None] + torch.matmul(local, rotation.transpose(1, 2)))
                first += len(points)
        return torch.cat(placed, dim=1)

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
        yaw, tilt = boxes[..., 6:7] - base_yaw[:, None], boxes[..., 7:]
        turns = math.pi * (yaw / math.pi).round()  # a box rotated by pi is the same, if tilted to the other side
        yaw, tilt = yaw - turns, turns.cos() * tilt
        angles = torch.cat((yaw, tilt), dim=-1)
        points_seen = self.seen_from(points, centre, half_sizes, angles, self.radii)
        aim = self.seen_from(target[:, None], centre, half_sizes, angles, torch.zeros_like(self.radii[:1]))
        turned = (yaw.sin(), yaw.cos(), *((tilt.sin(), tilt.cos()) if self.box_numbers > BOX_NUMBERS else ()))
        of_box = (LENGTH_SCALE * half_sizes, LENGTH_SCALE * centre, aim[..., 0, :6], *turned)
        return self.boxes(torch.cat((points_seen.flatten(2), *of_box), dim=-1))

    @staticmethod
    def seen_from(
        points: torch.Tensor, centre: torch.Tensor, half_sizes: torch.Tensor, angles: torch.Tensor, radii: torch.Tensor
    ) -> torch.Tensor:
        """Return points (n, p, 3) as boxes see them, (n, boxes, p, `POINT_NUMBERS`).

        `centre` and `half_sizes` are (n, boxes, 3) m; `angles` (n, boxes, 1 or 2) rad are yaws, or yaws and tilts.
        Balls of `radii` (p,) m are around points.
        """
        local = rotated(points[:, None] - centre[:, :, None], -angles[:, :, None, :1])
        if angles.shape[-1] > 1:
            local = _tilted_back(local, angles[:, :, None, 1:])
        beyond = local.abs() - half_sizes[:, :, None]
        distance = length(beyond.relu()) - radii[:, None]
        nearness = NEARBY / (NEARBY + distance.relu())
        return torch.cat((LENGTH_SCALE * torch.cat((local, beyond, distance), dim=-1), nearness), dim=-1)


def _pose_features(away: torch.Tensor, axes: torch.Tensor) -> torch.Tensor:
    """Return features (n, `POSE_NUMBERS`) of where the end-effector is, `away` (n, 3) m from its target.

    `axes` (n, 4, 3) are the first two of the end-effector, then of the target.
    """
    tip_axes, target_axes = axes[:, :2], axes[:, 2:]
    way = (frame_of(target_axes) @ away[:, :, None])[:, :, 0]
    scaled = [LENGTH_SCALE * way, *((way / scale).tanh() for scale in APPROACH_SCALES)]
    return torch.cat((axes.flatten(1), missing_turn(tip_axes, target_axes), *scaled), dim=1)


def _tilted_back(vectors: torch.Tensor, tilts: torch.Tensor) -> torch.Tensor:
    """Return vectors (..., 3) rotated about their y axis by minus the tilts (..., 1), rad."""
    x, y, z = vectors.split(1, dim=-1)
    return torch.cat((tilts.cos() * x - tilts.sin() * z, y, tilts.sin() * x + tilts.cos() * z), dim=-1)


def length(vectors: torch.Tensor) -> torch.Tensor:
    """Return lengths (..., 1) of vectors (..., 3)."""
    x, y, z = vectors.split(1, dim=-1)
    return (x * x + y * y + z * z).sqrt()
