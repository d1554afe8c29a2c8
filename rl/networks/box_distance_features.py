"""Features of an arm among boxes, without weights: distances from the boxes, of its links and of places around them.

A scene is what places that stand still see of it (Prokudin, Lassner and Romero, "Efficient learning on point clouds
with basis point sets", ICCV 2019): places in the room, about the target and about the hand. Links see how far the
nearest box is, and in which direction. So the number and the order of boxes do not matter, and examples are encoded
once. Forward kinematics is part of the network's graph.
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
    LinkPoints,
    for_each,
    frame_of,
    in_first_joint_frame,
    length,
    missing_turn,
    rotated,
)
from armctl.rl.networks.postures import Postures
from armctl.scene import TILTED_BOX_NUMBERS
from armctl.tasks.reach import observation_sizes
from armctl.tasks.reach.observation import LENGTH_SCALE

ROOM = (-1.1, -0.9, 0.05), (1.1, 1.1, 1.8), (6, 6, 5)
ABOUT_TARGET = (-0.24,) * 3, (0.24,) * 3, (4,) * 3
ABOUT_HAND = (-0.18,) * 3, (0.18,) * 3, (3,) * 3
"""Grids of places: first and last corner, m, and numbers of places along each axis, in the base's frame and in those of
target and end-effector."""
FAR, NEAR, TIGHT = 0.1, 0.05, 0.02
"""Distances whose nearness is a half, m."""
LARGEST_DISTANCE = 0.5
"""m: greater distances of links count as this."""
ABSENT = 9.0
"""m: distance of a box that is absent."""
NEAREST = 1e3
"""Rank of a free posture at home, beside which room is nothing."""
APPROACH_SCALES = 0.1, 0.02
"""m: the way to a pose counts on these scales too, since the hand has to fit between things there."""
NEAR_GOAL = 0.1
"""rad: scale on which joint motions to the posture at the target count once more."""
PLAIN_NUMBERS = 13 + 9
"""Count for positions of end-effector and target, offset and direction, distance, and the target's pose again."""
NUMBERS_PER_POINT = 9
"""Count for a point on a link: distance, nearness twice, direction and place (3 each)."""
POSE_NUMBERS = 12 + TURN_NUMBERS + 3 * (1 + len(APPROACH_SCALES))
"""Count for a target that is a pose: axes of end-effector and target, the turn, and the way in the target's frame."""


class BoxDistanceFeatures(BaseFeaturesExtractor):
    """Features of the observation `paper` of `armctl/ArmScenes-v0`, which ends with the boxes.

    `geometry` is what `ArmModel.geometry` says of the arm, whose first joint turns about the vertical.
    """

    def __init__(self, observation_space: spaces.Box, geometry: Mapping[str, Sequence[Any]]) -> None:
        links, postures = LinkPoints(geometry), Postures.of(geometry)
        parts = [*observation_sizes(links.dof).values(), 12]
        boxes = observation_space.shape[0] - sum(parts)
        if boxes <= 0 or boxes % TILTED_BOX_NUMBERS:
            raise ConfigurationError("these features are for an observation that ends with boxes that may be tilted")
        grids = {"room": grid(*ROOM), "about_target": grid(*ABOUT_TARGET), "about_hand": grid(*ABOUT_HAND)}
        of_arm = PLAIN_NUMBERS + POSE_NUMBERS + 2 * (links.dof - 1) + links.dof + NUMBERS_PER_POINT * len(links.radii)
        missing = 0 if postures is None else 2 * links.dof
        super().__init__(observation_space, of_arm + missing + sum(map(len, grids.values())))
        self.links, self.postures, self.parts = links, postures, [*parts, boxes]
        limits = {name: torch.tensor(geometry[name]) for name in ("lower", "upper", "home")}
        for name, numbers in {**grids, **limits}.items():
            self.register_buffer(name, numbers)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (n, k) of observations (n, 18 + dof + boxes)."""
        tip, joints, target, axes, numbers = observations.split(self.parts, dim=1)
        yaw = joints[:, :1]
        features, seen_target = in_first_joint_frame(tip, joints, yaw, target, length)
        pairs = axes.unflatten(1, (4, 3))
        features.append(pose_features(rotated(tip, -yaw) - seen_target, rotated(pairs, -yaw[:, None])))
        features += [joints, LENGTH_SCALE * target, pairs[:, 2:].flatten(1)]
        hand, goal = frame_of(pairs[:, :2]), frame_of(pairs[:, 2:])
        boxes = BoxFrames(numbers.unflatten(1, (-1, TILTED_BOX_NUMBERS)))
        if self.postures is not None:
            missing = self._nearest_turn(self._goal(target, goal, boxes), joints) - joints
            features += [missing, (missing / NEAR_GOAL).tanh()]
        features += self._of_links(joints, yaw, boxes)
        about_hand, about_target = tip[:, None] + self.about_hand @ hand, target[:, None] + self.about_target @ goal
        places = torch.cat((for_each(tip[:, None], self.room), about_hand, about_target), dim=1)
        distances = boxes.distances(places)
        of_room, of_poses = distances[:, : len(self.room)], distances[:, len(self.room) :]
        return torch.cat(
            (*features, spread(nearness(of_room, FAR), 0.2, 0.13), spread(nearness(of_poses, NEAR), 0.4, 0.2)), dim=1
        )

    def _goal(self, target: torch.Tensor, axes: torch.Tensor, boxes: "BoxFrames") -> torch.Tensor:
        """Return joint positions (n, dof) at the target in the free posture nearest to home, or else with most room."""
        joints, exists = self.postures(target, axes)
        points = self.links(joints)
        room = torch.minimum(boxes.distances(points.flatten(1, 2)).unflatten(1, points.shape[1:3]), points[..., 2])
        room = torch.where(exists, (room - self.links.radii).amin(dim=2), -ABSENT)
        rank = torch.where(room > 0, NEAREST / (1 + (joints - self.home).norm(dim=2)), room)
        best = rank.argmax(dim=1)[:, None, None].expand(-1, 1, joints.shape[2])
        return torch.gather(joints, 1, best)[:, 0]

    def _nearest_turn(self, goals: torch.Tensor, joints: torch.Tensor) -> torch.Tensor:
        """Shift `goals` (n, dof) by whole turns to be near `joints`, as far as the limits allow."""
        turn = 2 * math.pi
        near = goals + turn * ((joints - goals) / turn).round()
        return near + turn * ((near < self.lower).float() - (near > self.upper).float())

    def _of_links(self, joints: torch.Tensor, yaw: torch.Tensor, boxes: "BoxFrames") -> list[torch.Tensor]:
        points = self.links(joints)
        distances, directions = boxes.nearest(points)
        distances = distances - self.links.radii
        near = nearness(distances, FAR)
        ways = rotated(directions, -yaw[:, None]) * near[..., None]
        scaled = 2 * LENGTH_SCALE * (distances.clamp(-FAR, LARGEST_DISTANCE) - FAR)
        places = LENGTH_SCALE * points.flatten(1)
        return [
            scaled,
            spread(near, 0.3, 0.14),
            spread(nearness(distances, TIGHT), 0.09, 0.07),
            spread(ways.flatten(1), 0.0, 0.2),
            places,
        ]


def grid(first: Sequence[float], last: Sequence[float], numbers: Sequence[int]) -> torch.Tensor:
    """Return places (k, 3) of a grid."""
    along = [torch.linspace(*ends) for ends in zip(first, last, numbers, strict=True)]
    return torch.stack(torch.meshgrid(*along, indexing="ij"), dim=-1).reshape(-1, 3)


def nearness(distances: torch.Tensor, half: float) -> torch.Tensor:
    """Return the nearness, from 1 in contact to 0 at infinity; 0.5 at the distance `half` (m)."""
    return half / (half + distances.relu())


def spread(numbers: torch.Tensor, middle: float, width: float) -> torch.Tensor:
    """Return numbers that are mostly within `width` of the `middle` on the scale of the others: so a network learns."""
    return (numbers - middle) / width


class BoxFrames:
    """Boxes (n, k, `TILTED_BOX_NUMBERS`), of which some are absent, to measure distances from."""

    def __init__(self, boxes: torch.Tensor) -> None:
        centres, half_sizes, yaw, tilt = boxes[..., :3], boxes[..., 3:6], boxes[..., 6], boxes[..., 7]
        cos, sin, cos_tilt, sin_tilt = yaw.cos(), yaw.sin(), tilt.cos(), tilt.sin()
        axes = (
            (cos * cos_tilt, sin * cos_tilt, -sin_tilt),
            (-sin, cos, for_each(yaw, yaw.new_zeros(1))),
            (cos * sin_tilt, sin * sin_tilt, cos_tilt),
        )
        self.axes = torch.stack([torch.stack(axis, dim=-1) for axis in axes], dim=2)
        present = (half_sizes > 0).all(dim=-1, keepdim=True)
        own_centres = torch.where(present, (self.axes @ centres[..., None])[..., 0], ABSENT)
        self._turns = self.axes.flatten(1, 2).transpose(1, 2)
        self._centres, self._half_sizes = own_centres.flatten(1)[:, None], half_sizes.flatten(1)[:, None]

    def distances(self, points: torch.Tensor) -> torch.Tensor:
        """Return the distances (n, p), m, of `points` (n, p, 3) from the nearest box: below 0 inside."""
        return self._distances(points @ self._turns - self._centres).amin(dim=2)

    def nearest(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the same, and the directions (n, p, 3) from the nearest box, which are 0 inside."""
        local = points @ self._turns - self._centres
        distances, box = self._distances(local).min(dim=2)
        outside = ((local.abs() - self._half_sizes).relu() * local.sign()).unflatten(2, (-1, 3))
        offsets = torch.gather(outside, 2, box[..., None, None].expand(-1, -1, 1, 3))
        axes = torch.gather(self.axes, 1, box[..., None, None].expand(-1, -1, 3, 3))
        return distances, (offsets @ axes)[:, :, 0] / (length(offsets[:, :, 0]) + 1e-3)

    def _distances(self, local: torch.Tensor) -> torch.Tensor:
        beyond = (local.abs() - self._half_sizes).unflatten(2, (-1, 3))
        x, y, z = beyond.unbind(dim=-1)
        outside = (x.relu().square() + y.relu().square() + z.relu().square()).sqrt()
        return outside + torch.maximum(torch.maximum(x, y), z).clamp(max=0.0)


def pose_features(away: torch.Tensor, axes: torch.Tensor) -> torch.Tensor:
    """Return features (n, `POSE_NUMBERS`) of where the end-effector is, `away` (n, 3) m from its target.

    `axes` (n, 4, 3) are the first two of the end-effector, then of the target.
    """
    tip_axes, target_axes = axes[:, :2], axes[:, 2:]
    way = (frame_of(target_axes) @ away[:, :, None])[:, :, 0]
    scaled = [LENGTH_SCALE * way, *((way / scale).tanh() for scale in APPROACH_SCALES)]
    return torch.cat((axes.flatten(1), missing_turn(tip_axes, target_axes), *scaled), dim=1)
