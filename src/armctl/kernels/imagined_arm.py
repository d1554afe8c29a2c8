"""Arms that move among boxes as their drives are commanded, without physics: see `armctl.kinematics.imagined`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.kernels.arm import forward, tip_of
from armctl.kernels.capsules import place
from armctl.kernels.compiling import compiled
from armctl.kernels.drives import follow_all
from armctl.kernels.edges import NEAR_START, Bounds, Scene, check_edge, distance, measure_all

MOVING, ARRIVED, TOUCHED = range(3)
"""States of an arm's episode."""


class Arms(NamedTuple):
    """n arms of one kind, each among the first `counts[i]` of its `boxes`."""

    joints: NDArray[np.void]
    links: NDArray[np.void]
    pairs: NDArray[np.void]
    """Pairs of links and floor, then those of the links and each box: an arm has as many as its boxes need."""
    motion: NDArray[np.float64]
    """(pairs, dof) m/rad: bound on how far each joint moves a pair."""
    num_own_pairs: int
    pairs_per_box: int
    boxes: NDArray[np.void]
    """(n, most)."""
    counts: NDArray[np.int64]
    positions: NDArray[np.float64]
    """(n, dof) rad."""
    velocities: NDArray[np.float64]
    """(n, dof) rad/s."""
    targets: NDArray[np.float64]
    """(n, 3) m."""
    states: NDArray[np.int64]
    margins: NDArray[np.float64]
    """(n, pairs) m that an arm has to keep."""
    slack: NDArray[np.float64]
    """(n, pairs) m by which a pair exceeds its margin at least."""


@compiled
def number_of_pairs(arms, arm):
    """Return the number of pairs of an arm."""
    return arms.num_own_pairs + arms.pairs_per_box * arms.counts[arm]


@compiled
def scene_of(arms, arm):
    """Return an arm among its boxes."""
    return Scene(arms.joints, arms.links, arms.pairs[: number_of_pairs(arms, arm)], arms.boxes[arm])


@compiled
def begin(arms, ids, margin):
    """Set the margins that arms `ids` have to keep: `margin` (m), or a share of less at the start."""
    for arm in ids:
        margins, slack = arms.margins[arm], arms.slack[arm]
        measure_all(scene_of(arms, arm), arms.positions[arm], slack)
        for k in range(number_of_pairs(arms, arm)):
            margins[k] = min(margin, NEAR_START * max(slack[k], 0.0))
            slack[k] -= margins[k]


@compiled
def use_up(motion, slack, moved):
    """Reduce the `slack` of each pair after joints have `moved` (dof,) rad. Returns whether a pair has none left."""
    is_used_up = False
    for i in range(len(moved)):
        for k in range(len(slack)):
            slack[k] -= motion[k, i] * moved[i]
    for k in range(len(slack)):
        is_used_up = is_used_up or slack[k] < 0
    return is_used_up


@compiled
def keeps_margins(scene, margins, slack, ends):
    """Return True if no pair of an arm with segments' `ends` is below its margin; only used up pairs are measured."""
    _, links, pairs, boxes = scene
    for k in range(len(pairs)):
        if slack[k] < 0:
            slack[k] = distance(links, boxes, ends, pairs[k]) - margins[k]
            if slack[k] < 0:
                return False
    return True


@compiled
def move(arms, tolerance, goals, ticks, tick):
    """Move the arms (n,) that are `MOVING` on by some ticks (s) towards `goals` (n, dof), by the law of their drives.

    After each tick, an arm that is below a margin becomes `TOUCHED`, or else one within `tolerance` (m) `ARRIVED`.
    """
    joints, links, motion, states = arms.joints, arms.links, arms.motion, arms.states
    dof, frames = arms.positions.shape[1], len(joints)
    rotations, origins, moved = np.empty((frames, 3, 3)), np.empty((frames, 3)), np.empty(dof)
    ends, tip = np.empty((len(links), 2, 3)), np.empty(3)
    for arm in range(len(states)):
        scene, margins, slack = scene_of(arms, arm), arms.margins[arm], arms.slack[arm, : number_of_pairs(arms, arm)]
        position, velocity, target = arms.positions[arm], arms.velocities[arm], arms.targets[arm]
        for _ in range(ticks):
            if states[arm] != MOVING:
                break
            follow_all(joints, goals[arm], position, velocity, 1, tick)
            for i in range(dof):
                moved[i] = abs(velocity[i] * tick)
            forward(joints, position, rotations, origins)
            if use_up(motion, slack, moved):
                place(links, rotations, origins, ends)
                if not keeps_margins(scene, margins, slack, ends):
                    states[arm] = TOUCHED
                    break
            tip_of(joints, rotations, origins, tip)
            square = 0.0
            for i in range(3):
                square += (tip[i] - target[i]) ** 2
            if square <= tolerance * tolerance:
                states[arm] = ARRIVED


@compiled
def farthest_waypoints(arms, ways, lengths, margin, distances, farthest):
    """Raise `farthest` (n,) to the farthest of `ways` (n, most, dof) with a free straight motion, of `MOVING` arms.

    Way i has `lengths[i]` corners. Pairs keep `margin` (m), or a share of what is less at the start, as in
    `check_edge`, whose memory `distances` is.
    """
    margins = np.empty(len(arms.pairs))
    for arm in range(len(arms.states)):
        if arms.states[arm] != MOVING:
            continue
        scene, start = scene_of(arms, arm), arms.positions[arm]
        measure_all(scene, start, margins)
        for k in range(len(scene.pairs)):
            margins[k] = min(margin, NEAR_START * max(margins[k], 0.0))
        bounds = Bounds(margins, arms.motion, distances)
        for k in range(lengths[arm] - 1, farthest[arm], -1):
            free, _ = check_edge(scene, start, ways[arm, k], bounds)
            if free:
                farthest[arm] = k
                break
