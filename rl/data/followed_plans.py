"""Examples for a clone: imagined arms follow planned ways with noise, and every state gets a label that looks ahead.

The label is a move towards the farthest of the way's next waypoints to which a straight joint motion is free: it
depends on where the arm is, and leads back to the way. Nothing is simulated (`armctl.kinematics.imagined`).
"""

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kinematics import ArmShapes, ImaginedArms
from armctl.kinematics.imagined import MOVING
from armctl.rl.data.solved_layouts import SolvedLayouts
from armctl.tasks.reach import CONTROL_PERIOD
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES
from armctl.tasks.reach.obstacles import obstacles_observation

WAYPOINTS_APART = 0.3
"""Largest joint motion between waypoints, of which a way's corners are some, rad."""
MAX_STEPS = 75
"""Control steps (3 s) after which an arm stops to follow."""


@dataclass(frozen=True, kw_only=True)
class Following:
    """Options of arms that follow ways."""

    tolerance: float
    """Distance from the target at which an arm has arrived, m."""
    largest_move: float
    """Largest move of a joint in a label, rad."""
    margin: float
    """Distance kept by straight motions, m."""
    noise: float
    """Standard deviation of what is added to commands, rad."""
    noise_share: float
    """Probability that it is added in a control step."""


def follow(
    shapes: ArmShapes, layouts: SolvedLayouts, rows: NDArray[np.intp], rng: np.random.Generator, how: Following
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """Follow the ways of some `rows` of layouts: the row of every state, its joint positions and its label, (k, dof).

    Labels are absolute joint positions (rad). Arms that touch something, or have arrived, are done.
    """
    ways, lengths = _padded([waypoints(layouts.way(int(row))) for row in rows])
    n = len(rows)
    arms = ImaginedArms(shapes, n, MAX_OBSTACLES, tolerance=how.tolerance, period=CONTROL_PERIOD)
    arms.begin(np.arange(n), ways[:, 0], 0.0, layouts.targets[rows], layouts.boxes[rows])
    next_waypoint = np.ones(n, dtype=np.int64)
    states, positions, labels = [], [], []
    for _ in range(MAX_STEPS):
        moving = np.flatnonzero(arms.states == MOVING)
        if not len(moving):
            break
        arms.next_waypoints(ways, lengths, how.margin, next_waypoint)
        moves = ways[np.arange(n), next_waypoint] - arms.positions
        moves *= np.minimum(1.0, how.largest_move / np.maximum(abs(moves).max(axis=1, keepdims=True), 1e-9))
        states.append(rows[moving])
        positions.append(arms.positions[moving].astype(np.float32))
        labels.append((arms.positions + moves)[moving].astype(np.float32))
        is_disturbed = rng.random((n, 1)) < how.noise_share
        arms.move(arms.positions + moves + is_disturbed * rng.normal(scale=how.noise, size=moves.shape))
    return np.concatenate(states), np.concatenate(positions), np.concatenate(labels)


def waypoints(way: Array) -> Array:
    """Return a way (m, dof), rad, with points between its corners that are at most `WAYPOINTS_APART`."""
    points = [way[:1]]
    for start, end in itertools.pairwise(way):
        number = max(1, int(np.ceil(abs(end - start).max() / WAYPOINTS_APART)))
        points.append(start + (end - start) * np.linspace(0, 1, number + 1)[1:, None])
    return np.concatenate(points)


class FollowedPlans:
    """Examples from all layouts, of which a part is followed anew, with other noise, whenever `renew` is called."""

    def __init__(self, shapes: ArmShapes, layouts: SolvedLayouts, parts: int, how: Following) -> None:
        self._shapes, self._layouts, self._how, self._parts = shapes, layouts, how, parts
        self._examples: dict[int, tuple[NDArray[Any], ...]] = {}

    def renew(self, number: int, rng: np.random.Generator) -> int:
        """Follow the part of this number, counted on and on. Returns how many states were labelled."""
        part = number % self._parts
        rows = np.arange(part, len(self._layouts), self._parts)
        self._examples[part] = follow(self._shapes, self._layouts, rows, rng, self._how)
        parts = list(self._examples.values())
        self._rows, self._positions, self._labels = (np.concatenate([part[i] for part in parts]) for i in range(3))
        return len(self._examples[part][0])

    def draw(self, rng: np.random.Generator, size: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return a random batch of observations and actions (size, ...)."""
        samples = rng.integers(len(self._rows), size=size)
        rows, positions = self._rows[samples], self._positions[samples]
        observations = obstacles_observation(
            self._shapes.model, positions, self._layouts.targets[rows], self._layouts.boxes[rows]
        )
        return observations, self._labels[samples]


def _padded(ways: list[Array]) -> tuple[Array, NDArray[np.int64]]:
    """Return ways (n, longest, dof), and their lengths (n,)."""
    lengths = np.array([len(way) for way in ways], dtype=np.int64)
    padded = np.zeros((len(ways), lengths.max(), ways[0].shape[1]))
    for row, way in zip(padded, ways, strict=True):
        row[: len(way)] = way
    return padded, lengths
