"""Samples a bridge's layout for each episode: where blocks stand, pedestrians walk, and barriers are missing.

The bridge is divided into sections, one for each block or walker, in random order. A layout is accepted only if a rover
with `CLEARANCE` can pass, and if it has room to wait on both sides of each lane across the bridge.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError
from armctl.robots.rover import RADIUS
from armctl.scene import BridgeMap, PedestrianTrajectories
from armctl.tasks.bridge.options import WALKER_RADIUS, WALKER_SPEEDS
from armctl.tasks.bridge.world import (
    BLOCK_SIZES,
    GOAL_MARGIN,
    START_X,
    free_half_width,
    segment_names,
)

CLEARANCE = RADIUS + 0.14
"""m from the rover's centre to anything it must not touch, along a path that exists in every layout."""
RUN_UP, RUN_OUT = 1.5, 1.0
"""m without blocks and walkers after the start, and before the goal line."""
MAX_BLOCK_YAW = 0.6
"""rad."""
TURNING_MARGIN = WALKER_RADIUS + 0.05
"""m from a barrier, where people who walk across turn back."""
ALONG_SECTION = 1.6
"""Length of the section of a pedestrian who walks along the bridge, relative to that of a block."""
ATTEMPTS = 1000


def turning_y(half_width: float) -> float:
    """Return where walkers turn back, m from the middle of a deck that is free for `half_width` m on both sides."""
    return half_width - TURNING_MARGIN


@dataclass(frozen=True, eq=False)
class Layout:
    """The random part of an episode."""

    map: BridgeMap
    missing: NDArray[np.intp]
    """Indices of the missing jersey barriers."""


def sample_layout(
    rng: np.random.Generator, length: float, width: float, blocks: int, walkers: int, missing_barriers: int
) -> Layout:
    """Sample a layout that can be crossed. Raises `ConfigurationError` if none is found."""
    for _ in range(ATTEMPTS):
        bridge = _sample_map(rng, length, free_half_width(width), blocks, walkers)
        if _room_to_wait(bridge) and bridge.crossable(CLEARANCE):
            # The first and last barriers are never missing: they mark the ends of the bridge.
            inner = np.arange(2, len(segment_names(length)) - 2)
            return Layout(bridge, rng.permutation(inner)[:missing_barriers])
    raise ConfigurationError(
        f"none of {ATTEMPTS} layouts of {blocks} blocks and {walkers} walkers on {length} m by {width} m "
        "can be crossed: take fewer, or a larger deck"
    )


def _sample_map(rng: np.random.Generator, length: float, half_width: float, blocks: int, walkers: int) -> BridgeMap:
    along = rng.random(walkers) < 0.5
    weights = np.concatenate((np.ones(blocks), np.where(along, ALONG_SECTION, 1.0)))
    order = rng.permutation(blocks + walkers)
    first, last = START_X + RUN_UP, length - GOAL_MARGIN - RUN_OUT
    sections = np.zeros(blocks + walkers)
    sections[order] = weights[order] * (last - first) / max(weights.sum(), 1.0)
    ends = np.zeros(blocks + walkers)
    ends[order] = first + np.cumsum(sections[order])
    middles = ends - sections / 2

    jitter = rng.uniform(-0.15, 0.15, blocks) * sections[:blocks]
    y = rng.uniform(0.3 - half_width, half_width - 0.3, blocks)
    yaw = rng.uniform(-MAX_BLOCK_YAW, MAX_BLOCK_YAW, blocks)
    sizes = np.array([BLOCK_SIZES[i % len(BLOCK_SIZES)] for i in range(blocks)]).reshape(blocks, 2)
    placed = np.column_stack((middles[:blocks] + jitter, y, yaw, sizes))

    x, reach = middles[blocks:], sections[blocks:] / 2 - WALKER_RADIUS - 0.1
    side = turning_y(half_width)
    lane = rng.uniform(-side, side, walkers)
    start = np.where(along[:, None], np.column_stack((x - reach, lane)), np.column_stack((x, np.full(walkers, -side))))
    end = np.where(along[:, None], np.column_stack((x + reach, lane)), np.column_stack((x, np.full(walkers, side))))
    phase = rng.uniform(0, 2, walkers) * np.linalg.norm(end - start, axis=1)
    pedestrians = PedestrianTrajectories(start, end, rng.uniform(*WALKER_SPEEDS, walkers), phase, WALKER_RADIUS)
    return BridgeMap(length, half_width, placed, pedestrians)


def _room_to_wait(bridge: BridgeMap) -> bool:
    """Return True if the rover fits between each lane across the bridge and the obstacles before and behind it."""
    pedestrians, blocks = bridge.pedestrians, bridge.blocks
    across = pedestrians.start[:, 0] == pedestrians.end[:, 0]
    if not across.any():
        return True
    x, _, yaw, half_length, half_width = blocks.T
    extent = half_length * np.cos(yaw) + half_width * np.abs(np.sin(yaw))
    low = np.concatenate((x - extent, pedestrians.start[:, 0] - pedestrians.radius))
    high = np.concatenate((x + extent, pedestrians.end[:, 0] + pedestrians.radius))
    lanes = np.flatnonzero(across) + len(blocks)
    free = np.maximum(low[None] - high[lanes, None], low[lanes, None] - high[None])
    free[np.arange(len(lanes)), lanes] = np.inf
    return bool((free >= 2 * CLEARANCE).all())
