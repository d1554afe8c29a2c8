"""Distances of an arm's links, which are capsules, from boxes, the floor and each other.

Links are an array of `LINK`: `start` and `end` of the segment in the frame of its `joint` (0: the base, i: the i-th
joint's frame), and the radius. Boxes are an array of `BOX`, whose `rotation` has the box's axes as columns. `ends`
(links, 2, 3) are the segments' ends in the base.
"""

import math

import numpy as np

from armctl.kernels.arm import MATRIX, VECTOR, carried, forward
from armctl.kernels.compiling import compiled

LINK = np.dtype([("joint", int), ("start", *VECTOR), ("end", *VECTOR), ("radius", float)])
BOX = np.dtype([("rotation", *MATRIX), ("centre", *VECTOR), ("half_size", *VECTOR)])

TINY = 1e-12
"""m^2: segments that are points, or parallel."""


@compiled
def place(links, rotations, origins, ends):
    """Ends of all links' segments."""
    for i in range(len(links)):
        joint = links[i].joint
        if joint == 0:
            ends[i, 0], ends[i, 1] = links[i].start, links[i].end
        else:
            carried(rotations[joint - 1], origins[joint - 1], links[i].start, ends[i, 0])
            carried(rotations[joint - 1], origins[joint - 1], links[i].end, ends[i, 1])


@compiled
def place_all(joints, links, q, ends):
    """The same at each of q (n, dof): (n, links, 2, 3)."""
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    for row in range(len(q)):
        forward(joints, q[row], rotations, origins)
        place(links, rotations, origins, ends[row])


@compiled
def shares_on_segments(first, second):
    """The points of two segments (2, 3) that are nearest to each other, as shares from start to end.

    Ericson, "Real-time collision detection", 2005, section 5.1.9.
    """
    aa = cc = ac = ab = cb = 0.0
    for i in range(3):
        along, across = first[1, i] - first[0, i], second[1, i] - second[0, i]
        between = first[0, i] - second[0, i]
        aa += along * along
        cc += across * across
        ac += along * across
        ab += along * between
        cb += across * between
    share = min(max((ac * cb - ab * cc) / max(aa * cc - ac * ac, TINY), 0.0), 1.0)
    other = min(max((ac * share + cb) / max(cc, TINY), 0.0), 1.0)
    return min(max((ac * other - ab) / max(aa, TINY), 0.0), 1.0), other


@compiled
def segments_distance(first, second):
    """Distance of two segments (2, 3), m."""
    share, other = shares_on_segments(first, second)
    square = 0.0
    for i in range(3):
        one = first[0, i] + share * (first[1, i] - first[0, i])
        offset = one - second[0, i] - other * (second[1, i] - second[0, i])
        square += offset * offset
    return math.sqrt(square)


@compiled
def segment_box_distance(segment, box):
    """Distance of a segment (2, 3) from a box, m; 0 inside.

    The squared distance is a convex function of the share of the segment, and a parabola between the places where the
    segment crosses the planes of faces, of which there are at most six.
    """
    start, step, knots = np.empty(3), np.empty(3), np.ones(7)
    count = 0
    for i in range(3):
        start[i] = step[i] = 0.0
        for j in range(3):
            start[i] += box.rotation[j, i] * (segment[0, j] - box.centre[j])
            step[i] += box.rotation[j, i] * (segment[1, j] - segment[0, j])
        for side in (-box.half_size[i], box.half_size[i]):
            share = (side - start[i]) / step[i] if step[i] != 0 else 0.0
            if 0 < share < 1:
                k = count
                while k > 0 and knots[k - 1] > share:
                    knots[k] = knots[k - 1]
                    k -= 1
                knots[k] = share
                count += 1
    knots[count] = 1.0
    low = share = 0.0
    for k in range(count + 1):
        high = knots[k]
        slope = curvature = 0.0  # half the derivative at a share is slope + curvature share
        for i in range(3):
            at = start[i] + (low + high) / 2 * step[i]
            if abs(at) > box.half_size[i]:
                slope += step[i] * (start[i] - math.copysign(box.half_size[i], at))
                curvature += step[i] * step[i]
        share = high
        if slope + curvature * high >= 0:
            share = min(max(-slope / curvature, low), high) if curvature > 0 else low
            break
        low = high
    square = 0.0
    for i in range(3):
        beyond = max(abs(start[i] + share * step[i]) - box.half_size[i], 0.0)
        square += beyond * beyond
    return math.sqrt(square)


@compiled
def touches(links, pairs, on_floor, boxes, ends):
    """Whether one of the `pairs` (p, 2) of links touches, or a link of `on_floor` the floor, or a moving link a box."""
    for link in on_floor:
        if min(ends[link, 0, 2], ends[link, 1, 2]) <= links[link].radius:
            return True
    for first, second in pairs:
        if segments_distance(ends[first], ends[second]) <= links[first].radius + links[second].radius:
            return True
    for i in range(len(boxes)):
        for link in range(len(links)):
            if links[link].joint > 0 and segment_box_distance(ends[link], boxes[i]) <= links[link].radius:
                return True
    return False


@compiled
def are_free(joints, links, pairs, on_floor, boxes, q, free):
    """Whether an arm touches nothing at each of q (n, dof)."""
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    ends = np.empty((len(links), 2, 3))
    for row in range(len(q)):
        forward(joints, q[row], rotations, origins)
        place(links, rotations, origins, ends)
        free[row] = not touches(links, pairs, on_floor, boxes, ends)


@compiled
def box_distances(joints, links, boxes, q, least):
    """Lower `least` (k,) m to the distance of each box from the arm at q (dof,)."""
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    ends = np.empty((len(links), 2, 3))
    forward(joints, q, rotations, origins)
    place(links, rotations, origins, ends)
    for i in range(len(boxes)):
        for link in range(len(links)):
            least[i] = min(least[i], segment_box_distance(ends[link], boxes[i]) - links[link].radius)
