"""Scans of a bridge's state from the rover: distances in all directions, at present and where people will be."""

import math

import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.scene.pedestrians import turned_back
from armctl.tasks.bridge.observation import BLOCK, ROVER, WALKER

BEAMS = 48
AHEAD = (0.0, 0.4, 0.8, 1.2, 1.6)
"""Times at which people are predicted, s. They walk on straight, and turn back before they get to a barrier."""
NEAR = 0.5
"""Distance of which the nearness, NEAR / (NEAR + distance), is a half, m."""
FAR = 1e3
"""Distance of what is not hit, m."""
FLAT = 1e-6


class Surroundings(BaseFeaturesExtractor):
    """Scans of `BEAMS` directions around the rover, from an observed state (`full_state` of the bridge tasks).

    One scan is of what stands still, one more of people for each time `AHEAD`; to them come the rover's own pose and
    velocities. People are discs of `radius` m, and those who walk across turn back `turn` m from the middle.
    """

    def __init__(
        self,
        observation_space: spaces.Box,
        blocks: int,
        walkers: int,
        half_width: float,
        goal_x: float,
        radius: float,
        turn: float,
    ) -> None:
        scans = 1 + (len(AHEAD) if walkers else 0)
        super().__init__(observation_space, ROVER + scans * BEAMS)
        self.parts = [1] * ROVER + [BLOCK * blocks, WALKER * walkers]
        self.half_width, self.goal_x, self.radius, self.turn = half_width, goal_x, radius, turn
        angles = torch.arange(BEAMS) * (2 * math.pi / BEAMS)
        self.register_buffer("cosines", angles.cos())
        self.register_buffer("sines", angles.sin())

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (n, k) of states (n, m)."""
        x, y, cos, sin, speed, turn, blocks, walkers = observations.split(self.parts, dim=1)
        beams_x = cos * self.cosines - sin * self.sines
        beams_y = sin * self.cosines + cos * self.sines
        standing = self._to_sides(y, beams_y)
        if blocks.shape[1]:
            to_blocks = distances_to_blocks(x, y, beams_x, beams_y, blocks.unflatten(1, (-1, BLOCK)))
            standing = torch.minimum(standing, to_blocks)
        scans = [nearness(standing)]
        if walkers.shape[1]:
            people = walkers.unflatten(1, (-1, WALKER))
            for time in AHEAD:
                places = people_after(people, time, self.turn)
                scans.append(nearness(distances_to_discs(x, y, beams_x, beams_y, places, self.radius)))
        rover = (0.1 * (self.goal_x - x), y / self.half_width, cos, sin, speed, turn)
        return torch.cat((*rover, *scans), dim=1)

    def _to_sides(self, y: torch.Tensor, beams_y: torch.Tensor) -> torch.Tensor:
        distances = (self.half_width - y * beams_y.sign()) / beams_y.abs().clamp(min=FLAT)
        return distances.clamp(0.0, FAR)


def people_after(people: torch.Tensor, time: float, turn: float) -> torch.Tensor:
    """Return positions (n, k, 2) after `time` s of people (n, k, 4) who turn back `turn` m from the bridge's middle."""
    x, y = (people[..., :2] + time * people[..., 2:]).unbind(-1)
    return torch.stack((x, turned_back(y, turn)), dim=-1)


def nearness(distances: torch.Tensor) -> torch.Tensor:
    """Return the nearness, from 1 at a distance (m) of 0 to 0 at infinity."""
    return NEAR / (NEAR + distances)


def distances_to_blocks(
    x: torch.Tensor, y: torch.Tensor, beams_x: torch.Tensor, beams_y: torch.Tensor, blocks: torch.Tensor
) -> torch.Tensor:
    """Return distances (n, beams) m from points x, y (n, 1) to the nearest of blocks (n, k, 5) in each direction."""
    centre_x, centre_y, yaw, *half_sizes = blocks[:, None].unbind(-1)
    cos, sin = yaw.cos(), yaw.sin()
    from_x, from_y = x[..., None] - centre_x, y[..., None] - centre_y
    to_x, to_y = beams_x[..., None], beams_y[..., None]
    starts = (from_x * cos + from_y * sin, from_y * cos - from_x * sin)
    directions = (to_x * cos + to_y * sin, to_y * cos - to_x * sin)
    enters, leaves = [], []
    for start, direction, half in zip(starts, directions, half_sizes, strict=True):
        steady = torch.where(direction.abs() < FLAT, torch.full_like(direction, FLAT), direction)
        first, second = (-half - start) / steady, (half - start) / steady
        enters.append(torch.minimum(first, second))
        leaves.append(torch.maximum(first, second))
    enter, leave = torch.maximum(*enters), torch.minimum(*leaves)
    hit = (enter <= leave) & (leave >= 0)
    return torch.where(hit, enter.clamp(0.0, FAR), torch.full_like(enter, FAR)).amin(dim=-1)


def distances_to_discs(
    x: torch.Tensor, y: torch.Tensor, beams_x: torch.Tensor, beams_y: torch.Tensor, centres: torch.Tensor, radius: float
) -> torch.Tensor:
    """Return the same for discs with centres (n, k, 2)."""
    to_x, to_y = (centres[:, None] - torch.stack((x, y), dim=-1)[:, None]).unbind(-1)
    along = to_x * beams_x[..., None] + to_y * beams_y[..., None]
    across = to_x * beams_y[..., None] - to_y * beams_x[..., None]
    half_chord = (radius * radius - across * across).clamp(min=0.0).sqrt()
    hit = (across.abs() < radius) & (along + half_chord > 0)
    distances = (along - half_chord).clamp(0.0, FAR)
    return torch.where(hit, distances, torch.full_like(distances, FAR)).amin(dim=-1)
