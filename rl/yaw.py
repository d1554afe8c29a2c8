"""Rotations about the vertical, about which every scene may turn."""

import torch


def rotated(vectors: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """Vectors (..., 3) rotated about the vertical by angles (..., 1), rad."""
    x, y, z = vectors.split(1, dim=-1)
    return torch.cat((angles.cos() * x - angles.sin() * y, angles.sin() * x + angles.cos() * y, z), dim=-1)
