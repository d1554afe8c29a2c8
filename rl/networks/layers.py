"""Layers that several networks are built of."""

import itertools
from collections.abc import Sequence

import torch


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
