"""The joint positions of an arm at a pose, in each of its postures: closed form, as part of a network's graph.

It is for arms like those of Universal Robots: a vertical axis, three parallel horizontal ones, and two that intersect
at a right angle (Hawkins, "Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms", 2013).
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import torch

from armctl.rl.networks.layers import cross, for_each, joint_frames, length, rotated

TOLERANCE = 1e-3
"""Scalar product of axes, and distance of lines (m), within which axes are as is assumed."""
POSTURES = 8
"""Number of an arm's postures."""


class Postures(torch.nn.Module):
    """Configurations at poses with the shoulder on either side, the wrist turned and the elbow bent either way.

    `axes` and `origins` (6, 3) are those of the joints, and `tip` (3,) and `turn` (3, 3) the end-effector's place (m)
    and orientation, with all joints at 0.
    """

    def __init__(self, axes: torch.Tensor, origins: torch.Tensor, tip: torch.Tensor, turn: torch.Tensor) -> None:
        super().__init__()
        _, normal, _, _, wrist, last = axes
        _, shoulder, elbow, fourth, _, centre = origins
        upper, fore = (bone - normal * (bone @ normal) for bone in (elbow - shoulder, fourth - elbow))
        self.upper, self.fore = float(upper.norm()), float(fore.norm())
        ahead = upper / upper.norm()
        vectors = {
            "normal": normal, "wrist": wrist, "shoulder": shoulder, "hand": centre - fourth, "ahead": ahead,
            "above": cross(normal, ahead), "last_seen": last @ turn, "wrist_seen": wrist @ turn,
            "centre_seen": (centre - tip) @ turn,
        }  # fmt: skip
        for name, vector in vectors.items():
            self.register_buffer(name, vector)
        for name, pattern in {"shoulders": "++++----", "wrists": "--++--++", "elbows": "+-+-+-+-"}.items():
            self.register_buffer(name, torch.tensor([1.0 if sign == "+" else -1.0 for sign in pattern]))
        self.beside = float(normal @ centre)
        self.heading = math.atan2(float(normal[1]), float(normal[0]))
        self.bend = math.atan2(float(fore @ self.above), float(fore @ ahead))
        self.sign = float((normal @ last).sign())

    @classmethod
    def of(cls, geometry: Mapping[str, Sequence[Any]]) -> Self | None:
        """Return those of an arm with the `geometry` of `ArmModel.geometry`; None if it is not of this kind."""
        turns = torch.tensor([geometry["base"], geometry["sine"], geometry["versine"]])
        if turns.shape[1] != 6:
            return None
        frames = joint_frames(turns, torch.tensor(geometry["offset"]), torch.zeros(1, 6))
        rotations, origins = (torch.cat(parts) for parts in zip(*frames, strict=True))
        skews = turns[0].transpose(1, 2) @ turns[1]
        axes = (rotations @ torch.stack((skews[:, 2, 1], skews[:, 0, 2], skews[:, 1, 0]), dim=1)[..., None])[..., 0]
        vertical, normal, *parallel, wrist, last = axes
        vanish = torch.stack((
            1 - vertical[2], normal @ vertical, *(1 - normal @ axis for axis in parallel), normal @ wrist,
            last @ wrist, 1 - (normal @ last).abs(), *origins[0, :2], cross(origins[5] - origins[4], wrist).norm(),
        ))  # fmt: skip
        if (vanish.abs() > TOLERANCE).any():
            return None
        tip = origins[5] + rotations[5] @ torch.tensor(geometry["tip"])
        return cls(axes, origins, tip, rotations[5] @ torch.tensor(geometry["tip_turn"]))

    def forward(self, places: torch.Tensor, axes: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return joint positions (n, 8, 6), rad within one turn, and which (n, 8) are at the poses.

        Poses are `places` (n, 3) m, and `axes` (n, 3, 3), one per row. Where the arm does not reach a pose in a
        posture, it is somewhere near.
        """
        places, axes = places[:, None], axes[:, None]
        centre = places + (self.centre_seen @ axes)
        x, y = centre[..., 0], centre[..., 1]
        beside, exists = _angle_of(self.beside / (x * x + y * y).sqrt())
        middle, azimuth = torch.atan2(y, x) - self.heading, torch.atan2(places[..., 1], places[..., 0])
        is_behind = torch.cos(middle + beside - azimuth) <= torch.cos(middle - beside - azimuth)
        first = middle + self.shoulders * torch.where(is_behind, beside, -beside)
        normal = rotated(for_each(first[..., None], self.normal), first[..., None])
        last = self.last_seen @ axes
        fifth = self.wrists * _angle_of(self.sign * _dot(normal, last))[0]
        wrist = cross(last, normal)
        wrist = -self.sign * self.wrists[:, None] * wrist / (length(wrist) + 1e-9)
        sixth = -_turned(self.wrist_seen, (axes @ wrist[..., None])[..., 0], self.last_seen)
        total = _turned(self.wrist, rotated(wrist, -first[..., None]), self.normal)
        about = self.hand @ self.normal * self.normal
        across = self.hand - about
        hand = about + across * total.cos()[..., None] + cross(self.normal, across) * total.sin()[..., None]
        reach = rotated(for_each(hand, centre), -first[..., None]) - hand - self.shoulder
        ahead, above = reach @ self.ahead, reach @ self.above
        cosine = (ahead * ahead + above * above - self.upper**2 - self.fore**2) / (2 * self.upper * self.fore)
        bend, reaches = _angle_of(cosine)
        bend = self.elbows * bend
        third = bend - self.bend
        second = torch.atan2(above, ahead) - torch.atan2(self.fore * bend.sin(), self.upper + self.fore * bend.cos())
        joints = torch.stack((first, second, third, total - second - third, fifth, sixth), dim=-1)
        return joints - 2 * math.pi * (joints / (2 * math.pi)).round(), exists & reaches


def _angle_of(cosine: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return angles, and whether their cosines are what they should be."""
    return torch.acos(cosine.clamp(-1.0, 1.0)), cosine.abs() <= 1.0


def _dot(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    x, y, z = (first * second).unbind(dim=-1)
    return x + y + z


def _turned(first: torch.Tensor, second: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Return the angles (...) about an axis (3,) from a vector (3,) to others (..., 3)."""
    return torch.atan2(second @ cross(axis, first), second @ first)
