"""Parts that several networks are built of."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import torch

from armctl.tasks.reach.observation import LENGTH_SCALE, NEARBY

OBJECT_SPEED_SCALE = 4.0, 4.0, 0.5
"""s/m, s/m and s/rad: scale velocities of an object on a table to the order of one."""
TURN_NUMBERS = 9 + 3 + 1 + 3
"""Count of features of a turn."""
NEARBY_TURN = 0.2
"""Distance of axes, nearer than which the direction of the turn fades."""


def hidden_layers(sizes: Sequence[int]) -> list[torch.nn.Module]:
    """Return linear layers between so many units, each followed by a rectifier."""
    return [
        layer
        for inputs, outputs in itertools.pairwise(sizes)
        for layer in (torch.nn.Linear(inputs, outputs), torch.nn.ReLU())
    ]


def padded(part: torch.Tensor, count: int) -> torch.Tensor:
    """Return a part of an observation (n, k), followed by zeros: what `count` actions are relative to, (n, count)."""
    others = count - part.shape[1]
    return torch.nn.functional.pad(part, (0, others)) if others else part


def for_each(worlds: torch.Tensor, numbers: torch.Tensor) -> torch.Tensor:
    """Return the same `numbers` for each of the `worlds`, whose own are finite.

    With an addition in place of an expansion, the sizes of all arrays of an agent are known before it runs.
    """
    return numbers + 0.0 * worlds


def rotated(vectors: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """Return vectors (..., 3) rotated about the vertical by angles (..., 1), rad."""
    (x, y, z), cos, sin = vectors.split(1, dim=-1), angles.cos(), angles.sin()
    return torch.cat((cos * x - sin * y, sin * x + cos * y, z), dim=-1)


def object_motion(velocity: torch.Tensor, yaw: torch.Tensor) -> torch.Tensor:
    """Return the scaled velocity (n, 3) of an object on a table: x and y rotated back by `yaw` (n, 1), and its turn."""
    scaled = velocity * torch.tensor(OBJECT_SPEED_SCALE)
    return torch.cat((in_plane(scaled[:, :2], -yaw), scaled[:, 2:]), dim=1)


def in_plane(vectors: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """Return vectors (n, 2) rotated by angles (n, 1), rad."""
    return rotated(torch.nn.functional.pad(vectors, (0, 1)), angles)[:, :2]


def doubled(turn: torch.Tensor) -> torch.Tensor:
    """Return cosine and sine (n, 2) of twice an angle, of which they are given: equal for two directions of a line."""
    cosine, sine = turn.split(1, dim=1)
    return torch.cat((cosine.square() - sine.square(), 2 * cosine * sine), dim=1)


def in_first_joint_frame(
    tip: torch.Tensor,
    joints: torch.Tensor,
    yaw: torch.Tensor,
    target: torch.Tensor,
    length: Callable[[torch.Tensor], torch.Tensor],
) -> tuple[list[torch.Tensor], torch.Tensor]:
    """Return features of an arm in the frame that turns with its first joint, and its target there.

    They are positions (m) of tip and target, offset and distance, all scaled, the direction, and the posture. `yaw`
    (n, 1) is the position of the first joint, whose axis is vertical; `length` maps vectors (n, 3) to lengths (n, 1).
    """
    tip, target = rotated(tip, -yaw), rotated(target, -yaw)
    offset = target - tip
    distance = length(offset)
    lengths = LENGTH_SCALE * torch.cat((tip, target, offset, distance), dim=1)
    return [lengths, offset / (distance + NEARBY), joints[:, 1:].sin(), joints[:, 1:].cos()], target


def missing_turn(tip_axes: torch.Tensor, target_axes: torch.Tensor) -> torch.Tensor:
    """Return features (n, `TURN_NUMBERS`) of the turn from one orientation to another, of whose axes (n, 2, 3) are two.

    They are the relative rotation, the sum of its axes' cross products, which is 2 sin(angle) about the axis to turn
    about, the distance of the axes, which is sqrt(8) sin(angle / 2), and the former as a direction that fades near 0.
    """
    tip, target = frame_of(tip_axes), frame_of(target_axes)
    turn, twists = (tip @ target.transpose(1, 2)).flatten(1), cross(tip, target)
    twist = twists[:, 0] + twists[:, 1] + twists[:, 2]  # a sum over an axis would depend on the number of worlds
    distance = (target - tip).flatten(1).norm(dim=1, keepdim=True)
    return torch.cat((turn, twist, distance, twist / (distance + NEARBY_TURN)), dim=1)


def frame_of(axes: torch.Tensor) -> torch.Tensor:
    """Return all three axes (n, 3, 3), one per row, of the first two (n, 2, 3)."""
    return torch.cat((axes, cross(axes[:, :1], axes[:, 1:])), dim=1)


def cross(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Return cross products (..., 3)."""
    x, y, z = a.unbind(dim=-1)
    u, v, w = b.unbind(dim=-1)
    return torch.stack((y * w - z * v, z * u - x * w, x * v - y * u), dim=-1)


def joint_frames(
    turns: torch.Tensor, offsets: torch.Tensor, joints: torch.Tensor
) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Yield the rotation (..., 3, 3) and origin (..., 3) of each joint's frame at `joints` (..., dof).

    `turns` (3, dof, 3, 3) and `offsets` (dof, 3) are base, sine and versine, and offset of `ArmModel.geometry`.
    """
    for k in range(turns.shape[1]):
        angle = joints[..., k, None, None]
        base, sine, versine = turns[:, k]
        turn = base + angle.sin() * sine + (1 - angle.cos()) * versine
        if k == 0:
            rotation, origin = turn, for_each(joints[..., :1], offsets[0])
        else:
            origin = origin + torch.matmul(rotation, offsets[k])
            rotation = torch.matmul(rotation, turn)
        yield rotation, origin


class LinkPoints(torch.nn.Module):
    """Points along the links of an arm whose `geometry` is that of `ArmModel.geometry`."""

    def __init__(self, geometry: Mapping[str, Sequence[Any]]) -> None:
        super().__init__()
        turns = torch.tensor([geometry["base"], geometry["sine"], geometry["versine"]])
        self.dof = turns.shape[1]
        self.points_of = [[i for i, joint in enumerate(geometry["joint"]) if joint == k + 1] for k in range(self.dof)]
        """Numbers of the points that each joint moves, which are in this order."""
        self.register_buffer("turns", turns)
        self.register_buffer("offsets", torch.tensor(geometry["offset"]))
        order = [i for points in self.points_of for i in points]
        self.register_buffer("points", torch.tensor(geometry["points"])[order])
        self.register_buffer("radii", torch.tensor(geometry["radii"])[order])

    def forward(self, joints: torch.Tensor) -> torch.Tensor:
        """Return points (..., p, 3) m in the base's frame, at `joints` (..., dof)."""
        placed, first = [], 0
        for points, (rotation, origin) in zip(
            self.points_of, joint_frames(self.turns, self.offsets, joints), strict=True
        ):
            if points:
                local = self.points[first : first + len(points)]
                placed.append(origin[..., None, :] + torch.matmul(local, rotation.transpose(-1, -2)))
                first += len(points)
        return torch.cat(placed, dim=-2)


def length(vectors: torch.Tensor) -> torch.Tensor:
    """Return lengths (..., 1) of vectors (..., 3)."""
    x, y, z = vectors.split(1, dim=-1)
    return (x * x + y * y + z * z).sqrt()
