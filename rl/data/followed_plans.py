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
from armctl.kinematics.imagined import ARRIVED, MOVING
from armctl.rl.data.solved_layouts import SolvedLayouts
from armctl.rl.networks.actor import EncodedActor
from armctl.robot_description import JointLimits
from armctl.tasks.reach import CONTROL_PERIOD
from armctl.tasks.reach.obstacles import obstacles_observation

WAYPOINTS_APART = 0.3
"""Largest joint motion between waypoints, of which a way's corners are some, rad."""
ENCODED_AT_ONCE = 128
"""Number of states whose features are computed at once: with more, each takes longer."""
NEAR_END, NEAR_CORNER = 0.015, 0.05
"""Distances of joints, rad: from the end of a way at which an arm has arrived in a pose, and from a corner behind which
it goes to the next one, also if that leads nearer to things than the margin."""


@dataclass(frozen=True, kw_only=True)
class Following:
    """Options of arms that follow ways."""

    tolerance: float
    """Distance from a target position at which an arm has arrived, m."""
    largest_move: float
    """Largest move of a joint in a label, rad."""
    margin: float
    """Distance kept by straight motions, m."""
    noise: float
    """Largest standard deviation of what is added to commands, rad."""
    noise_share: float
    """Probability that it is added in a control step."""
    noise_power: float = 0.0
    """Power of a uniform random number by which an arm's noise is less: 0 for the same noise, as many arms in tight
    places need little to arrive."""
    late_share: float = 0.0
    """Share of arms that begin at some waypoint of their way, where others rarely get with noise."""
    max_steps: int = 75
    """Control steps after which an arm stops to follow."""
    straight: bool = False
    """True: labels move joints in proportion (see `limited_moves`). False: the larger moves end later."""


def follow(
    shapes: ArmShapes,
    layouts: SolvedLayouts,
    rows: NDArray[np.intp],
    rng: np.random.Generator,
    how: Following,
) -> tuple[NDArray[np.intp], NDArray[np.float32], NDArray[np.float32]]:
    """Follow the ways of some `rows` of layouts: the row of every state, its joint positions and its label, (k, dof).

    Labels are absolute joint positions (rad). Arms that touch something, or have arrived, are done.
    """
    ways, lengths = _padded([waypoints(layouts.way(int(row))) for row in rows])
    n = len(rows)
    targets, boxes, every = layouts.targets[rows], layouts.boxes[rows], np.arange(n)
    has_poses = targets.shape[1] > 3
    tolerance = 0.0 if has_poses else how.tolerance
    arms = ImaginedArms(shapes, n, boxes.shape[1], tolerance=tolerance, period=CONTROL_PERIOD)
    first = (rng.random(n) * (lengths - 1)).astype(int) * (rng.random(n) < how.late_share)
    arms.begin(every, ways[every, first], 0.0, targets[:, :3], boxes)
    next_waypoint = first + 1
    noise = how.noise * rng.random((n, 1)) ** how.noise_power
    states, positions, labels = [], [], []
    for _ in range(how.max_steps):
        moving = np.flatnonzero(arms.states == MOVING)
        if not len(moving):
            break
        arms.next_waypoints(ways, lengths, how.margin, next_waypoint)
        if has_poses:
            at_corner = abs(ways[every, next_waypoint] - arms.positions).max(axis=1) < NEAR_CORNER
            next_waypoint = np.minimum(next_waypoint + at_corner, lengths - 1)
        moves = ways[every, next_waypoint] - arms.positions
        moves = limited_moves(moves, how.largest_move, shapes.model.limits if how.straight else None)
        states.append(rows[moving])
        positions.append(arms.positions[moving].astype(np.float32))
        labels.append((arms.positions + moves)[moving].astype(np.float32))
        is_disturbed = rng.random((n, 1)) < how.noise_share
        arms.move(arms.positions + moves + is_disturbed * rng.normal(scale=noise, size=moves.shape))
        if has_poses:
            at_end = abs(ways[every, lengths - 1] - arms.positions).max(axis=1) < NEAR_END
            arms.states[at_end & (arms.states == MOVING)] = ARRIVED
    return np.concatenate(states), np.concatenate(positions), np.concatenate(labels)


def limited_moves(moves: Array, largest_move: float, straight: JointLimits | None) -> Array:
    """Return moves (n, dof) of joints, rad, made less, so that none is larger than `largest_move`.

    With the limits of the drives, joints will move in proportion. A drive accelerates all it can: sent ahead by m in
    each control step, it goes at a speed v from which it could stop there, v^2 / (2 a) + v T / 2 = m. These speeds are
    in proportion then, instead of the moves.
    """
    largest = np.maximum(abs(moves).max(axis=1, keepdims=True), 1e-9)
    limited = np.minimum(largest, largest_move)
    if straight is None:
        return np.asarray(moves * (limited / largest))
    a, half_period = straight.acceleration, CONTROL_PERIOD / 2
    slowest = (np.sqrt((a * half_period) ** 2 + 2 * a * limited) - a * half_period).min(axis=1, keepdims=True)
    speeds = slowest * moves / largest
    return np.asarray(speeds * abs(speeds) / (2 * a) + speeds * half_period)


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
        """Follow the part of this number, counted on and on, in place of what it was. Returns the number of labels."""
        part = number % self._parts
        rows = np.arange(part, len(self._layouts), self._parts)
        examples = follow(self._shapes, self._layouts, rows, rng, self._how)
        self._examples[part] = self._stored(*examples)
        return len(examples[0])

    def draw(self, rng: np.random.Generator, size: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return a random batch of observations and actions (size, ...)."""
        return self._batch(*self._rows_of_parts(rng, size))

    def _rows_of_parts(self, rng: np.random.Generator, size: int) -> list[NDArray[Any]]:
        """Return random rows of what is stored."""
        parts = list(self._examples.values())
        ends = np.cumsum([len(part[0]) for part in parts])
        samples = rng.integers(ends[-1], size=size)
        of_part = np.searchsorted(ends, samples, side="right")
        batch = [np.empty((size, *array.shape[1:]), array.dtype) for array in parts[0]]
        for number, part in enumerate(parts):
            chosen = of_part == number
            local = samples[chosen] - ends[number] + len(part[0])
            for into, array in zip(batch, part, strict=True):
                into[chosen] = array[local]
        return batch

    def _stored(self, rows: Any, positions: Any, labels: Any, /) -> tuple[NDArray[Any], ...]:
        """Return what is kept of the rows of states, their joint positions and labels."""
        return rows, positions, labels

    def _batch(self, rows: Any, positions: Any, labels: Any, /) -> tuple[NDArray[Any], NDArray[Any]]:
        return self._observations(rows, positions), labels

    def _observations(self, rows: NDArray[np.intp], positions: NDArray[np.float32]) -> NDArray[np.float32]:
        layouts = self._layouts
        return obstacles_observation(self._shapes.model, positions, layouts.targets[rows], layouts.boxes[rows])


class EncodedPlans(FollowedPlans):
    """The same for an actor whose features have no weights: they are computed once, and drawn with its own actions."""

    def __init__(
        self, shapes: ArmShapes, layouts: SolvedLayouts, parts: int, how: Following, actor: EncodedActor
    ) -> None:
        super().__init__(shapes, layouts, parts, how)
        self._actor = actor

    def _stored(self, rows: Any, positions: Any, labels: Any, /) -> tuple[NDArray[Any], ...]:
        features = np.empty((len(rows), self._actor.num_features), np.float16)
        actions = np.empty(labels.shape, np.float32)
        for start in range(0, len(rows), ENCODED_AT_ONCE):
            few = slice(start, start + ENCODED_AT_ONCE)
            observations = self._observations(rows[few], positions[few])
            features[few], actions[few] = self._actor.encoded(observations, labels[few])
        return features, actions

    def _batch(self, *stored: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        features, actions = stored
        return features, actions


def _padded(ways: list[Array]) -> tuple[Array, NDArray[np.int64]]:
    """Return ways (n, longest, dof), and their lengths (n,)."""
    lengths = np.array([len(way) for way in ways], dtype=np.int64)
    padded = np.zeros((len(ways), lengths.max(), ways[0].shape[1]))
    for row, way in zip(padded, ways, strict=True):
        row[: len(way)] = way
    return padded, lengths
