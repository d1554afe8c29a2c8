"""Arms that move among boxes as their drives are commanded, without physics: see `armctl.kinematics.imagined`.

Arm i of n has the first `counts[i]` boxes of `boxes` (n, most). Its pairs are the first of `pairs`: `own` of links and
floor, then `each` for every box.
"""

import numpy as np

from armctl.kernels.arm import forward, tip_of
from armctl.kernels.capsules import place
from armctl.kernels.compiling import compiled, copy_to
from armctl.kernels.drives import follow_all
from armctl.kernels.edges import check_edge, distance

MOVING, ARRIVED, TOUCHED = range(3)
"""States of an arm's episode."""


@compiled
def number_of_pairs(shape, counts, arm):
    """Return the number of pairs of an arm; `shape` is `own` and `each`."""
    return shape[0] + shape[1] * counts[arm]


@compiled
def begin(robot, shape, boxes, counts, ids, positions, margin, share, margins, slack):
    """Set the `margins` (n, pairs) m that arms `ids` have to keep: `margin`, or a `share` of less at the start."""
    joints, links, pairs = robot
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    ends = np.empty((len(links), 2, 3))
    for arm in ids:
        forward(joints, positions[arm], rotations, origins)
        place(links, rotations, origins, ends)
        for k in range(number_of_pairs(shape, counts, arm)):
            away = distance(links, boxes[arm], ends, pairs[k])
            margins[arm, k] = min(margin, share * max(away, 0.0))
            slack[arm, k] = away - margins[arm, k]


@compiled
def move(
    robot, motion, shape, boxes, counts, targets, tolerance, goals, ticks, tick, positions, velocities, margins, slack,
    states,
):  # fmt: skip
    """Move the arms (n,) that are `MOVING` on by some ticks (s) towards `goals` (n, dof), by the law of their drives.

    After each tick, an arm that is below a margin becomes `TOUCHED`, or else one in its sphere `ARRIVED`. A pair is
    measured only after its links may have used up the `slack` (n, pairs) m that they had when it was measured last:
    `motion` (pairs, dof) bounds how far each joint moves a pair, m/rad.
    """
    joints, links, pairs = robot
    dof = len(joints)
    rotations, origins, moved = np.empty((dof, 3, 3)), np.empty((dof, 3)), np.empty(dof)
    ends, tip = np.empty((len(links), 2, 3)), np.empty(3)
    for arm in range(len(states)):
        for _ in range(ticks):
            if states[arm] != MOVING:
                break
            follow_all(joints, goals[arm], positions[arm], velocities[arm], 1, tick)
            for i in range(dof):
                moved[i] = abs(velocities[arm, i] * tick)
            forward(joints, positions[arm], rotations, origins)
            place(links, rotations, origins, ends)
            for k in range(number_of_pairs(shape, counts, arm)):
                for i in range(dof):
                    slack[arm, k] -= motion[k, i] * moved[i]
                if slack[arm, k] < 0:
                    slack[arm, k] = distance(links, boxes[arm], ends, pairs[k]) - margins[arm, k]
                    if slack[arm, k] < 0:
                        states[arm] = TOUCHED
                        break
            tip_of(joints, rotations, origins, tip)
            square = 0.0
            for i in range(3):
                square += (tip[i] - targets[arm, i]) ** 2
            if states[arm] == MOVING and square <= tolerance * tolerance:
                states[arm] = ARRIVED


@compiled
def farthest_waypoints(
    robot, motion, shape, boxes, counts, states, positions, ways, lengths, margin, share, slack_factor, finest,
    distances, farthest,
):  # fmt: skip
    """Raise `farthest` (n,) to the farthest of `ways` (n, most, dof) with a free straight motion, of `MOVING` arms.

    Way i has `lengths[i]` corners. Pairs keep `margin`, or a `share` of what is less at the start, at checked
    configurations, and these by `slack_factor` in between. `finest` and `distances` are those of `check_edge`.
    """
    joints, links, pairs = robot
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    ends, margins, kept = np.empty((len(links), 2, 3)), np.empty(len(pairs)), np.empty(len(pairs))
    start = np.empty(len(joints))
    for arm in range(len(states)):
        if states[arm] != MOVING:
            continue
        count = number_of_pairs(shape, counts, arm)
        copy_to(positions[arm], start)
        forward(joints, start, rotations, origins)
        place(links, rotations, origins, ends)
        for k in range(count):
            margins[k] = min(margin, share * max(distance(links, boxes[arm], ends, pairs[k]), 0.0))
            kept[k] = margins[k] / slack_factor
        for k in range(lengths[arm] - 1, farthest[arm], -1):
            free, _ = check_edge(
                joints, links, pairs[:count], boxes[arm], start, ways[arm, k], margins, kept, motion, finest, distances
            )
            if free:
                farthest[arm] = k
                break
