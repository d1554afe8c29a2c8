"""Parts that several networks are built of."""

import itertools
from collections.abc import Callable, Sequence

import torch

from armctl.tasks.reach.observation import LENGTH_SCALE, NEARBY


def hidden_layers(sizes: Sequence[int]) -> list[torch.nn.Module]:
    """Return linear layers between so many units, each followed by a rectifier."""
    return [
        layer
        for inputs, outputs in itertools.pairwise(sizes)
        for layer in (torch.nn.Linear(inputs, outputs), torch.nn.ReLU())
    ]


def rotated(vectors: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """Return vectors (..., 3) rotated about the vertical by angles (..., 1), rad."""
    x, y, z = vectors.split(1, dim=-1)
    return torch.cat((angles.cos() * x - angles.sin() * y, angles.sin() * x + angles.cos() * y, z), dim=-1)


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
