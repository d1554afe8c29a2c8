"""Continuous collision checks of straight joint motions: see `armctl.kinematics.edge_checker`.

Pairs are an array of `PAIR`: two links; a link's end and the floor; or a link and a box.
"""

import numpy as np

from armctl.kernels.arm import forward
from armctl.kernels.capsules import place, segment_box_distance, segments_distance
from armctl.kernels.compiling import compiled

PAIR = np.dtype([("kind", int), ("link", int), ("other", int)])
LINKS, FLOOR_END, LINK_AND_BOX = range(3)


@compiled
def distances(joints, links, pairs, boxes, q, out):
    """Distance of each pair at q (dof,), (pairs,) m; 0 or below in contact."""
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    ends = np.empty((len(links), 2, 3))
    forward(joints, q, rotations, origins)
    place(links, rotations, origins, ends)
    for i in range(len(pairs)):
        kind, link, other = pairs[i].kind, pairs[i].link, pairs[i].other
        if kind == LINKS:
            out[i] = segments_distance(ends[link], ends[other]) - links[link].radius - links[other].radius
        elif kind == FLOOR_END:
            out[i] = ends[link, other, 2] - links[link].radius
        else:
            out[i] = segment_box_distance(ends[link], boxes[other]) - links[link].radius


@compiled
def keeps(distances, margins):
    """Whether all distances are at least as large as their margins."""
    nearest = np.inf
    for i in range(len(margins)):
        nearest = min(nearest, distances[i] - margins[i])
    return nearest >= 0


@compiled
def check_edge(joints, links, pairs, boxes, a, b, margins, kept, motion, finest, known):
    """Whether the motion from `a` to `b` (dof,) keeps the distances `kept`, and how many configurations were looked at.

    At these, distances are at least `margins`. `motion` (pairs, dof) bounds how far each joint moves a pair, m/rad.
    `known` (m, pairs) is memory for distances; the motion counts as blocked if it does not suffice, or if spans become
    shorter than `finest`.
    """
    dof = len(joints)
    distances(joints, links, pairs, boxes, b, known[1])
    if not keeps(known[1], margins):
        return False, 1
    distances(joints, links, pairs, boxes, a, known[0])
    if not keeps(known[0], margins):
        return False, 2
    moved, q = np.zeros(len(pairs)), np.empty(dof)
    for i in range(len(pairs)):
        for j in range(dof):
            moved[i] += motion[i, j] * abs(b[j] - a[j])
    spans, rows = np.empty((2 * len(known), 2)), np.empty((2 * len(known), 2), np.int64)
    spans[0, 0], spans[0, 1], rows[0, 0], rows[0, 1] = 0.0, 1.0, 0, 1
    first, last, checks = 0, 1, 2
    while first < last:
        low, high = spans[first]
        at_low, at_high = rows[first]
        first += 1
        enough = True
        for i in range(len(pairs)):
            if known[at_low, i] + known[at_high, i] < 2 * kept[i] + moved[i] * (high - low):
                enough = False
                break
        if enough:
            continue
        if high - low < finest or checks == len(known):
            return False, checks
        middle = (low + high) / 2
        for j in range(dof):
            q[j] = a[j] + middle * (b[j] - a[j])
        distances(joints, links, pairs, boxes, q, known[checks])
        checks += 1
        if not keeps(known[checks - 1], margins):
            return False, checks
        spans[last, 0], spans[last, 1], rows[last, 0], rows[last, 1] = low, middle, at_low, checks - 1
        spans[last + 1, 0], spans[last + 1, 1] = middle, high
        rows[last + 1, 0], rows[last + 1, 1] = checks - 1, at_high
        last += 2
    return True, checks
