"""Distances of an arm's links, which are capsules, from boxes, the floor and each other.

Links are an array of `LINK`: `start` and `end` of the segment in the frame of its `joint` (0: the base, i: the i-th
joint's frame), and the radius. Boxes are an array of `BOX`, whose `rotation` has the box's axes as columns. `ends`
(links, 2, 3) are the segments' ends in the base.
"""

import math

import numpy as np

from armctl.kernels.arm import MATRIX, VECTOR, carried, forward
from armctl.kernels.compiling import compiled, copy_to

LINK = np.dtype([("joint", int), ("start", *VECTOR), ("end", *VECTOR), ("radius", float)])
BOX = np.dtype([("rotation", *MATRIX), ("centre", *VECTOR), ("half_size", *VECTOR)])

TINY = 1e-12
"""m^2: segments that are points, or parallel."""


@compiled
def place(links, rotations, origins, ends):
    """Compute the ends of all links' segments."""
    for i in range(len(links)):
        joint = links[i].joint
        if joint == 0:
            copy_to(links[i].start, ends[i, 0])
            copy_to(links[i].end, ends[i, 1])
        else:
            carried(rotations[joint - 1], origins[joint - 1], links[i].start, ends[i, 0])
            carried(rotations[joint - 1], origins[joint - 1], links[i].end, ends[i, 1])


@compiled
def ends_at(joints, links, q):
    """Return the ends of all links' segments, (links, 2, 3), at q (dof,)."""
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    ends = np.empty((len(links), 2, 3))
    forward(joints, q, rotations, origins)
    place(links, rotations, origins, ends)
    return ends


@compiled
def place_all(joints, links, q, ends):
    """Compute the ends of all links' segments, (n, links, 2, 3), at each of q (n, dof)."""
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    for row in range(len(q)):
        forward(joints, q[row], rotations, origins)
        place(links, rotations, origins, ends[row])


@compiled
def shares_on_segments(first, second):
    """Return the points of two segments (2, 3) nearest to each other, as shares from start to end.

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
    """Return the distance of two segments (2, 3), m."""
    share, share_of_second = shares_on_segments(first, second)
    square = 0.0
    for i in range(3):
        along_first = first[0, i] + share * (first[1, i] - first[0, i])
        offset = along_first - second[0, i] - share_of_second * (second[1, i] - second[0, i])
        square += offset * offset
    return math.sqrt(square)


@compiled
def in_frame(box, vector):
    """Rotate a vector (3,) of the base into the axes of a box."""
    rotation, x, y, z = box.rotation, vector[0], vector[1], vector[2]
    return (
        rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z,
        rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z,
        rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z,
    )


@compiled
def offset(start, step, half_size, share):
    """Compute the offset of a segment's point from the nearest point of a box, in the box's frame; zero inside."""
    x, y, z = start[0] + share * step[0], start[1] + share * step[1], start[2] + share * step[2]
    return (
        x - min(max(x, -half_size[0]), half_size[0]),
        y - min(max(y, -half_size[1]), half_size[1]),
        z - min(max(z, -half_size[2]), half_size[2]),
    )


@compiled
def slope(start, step, half_size, share):
    """Return half the derivative of the squared distance of a segment's point from a box, by the segment's share."""
    x, y, z = offset(start, step, half_size, share)
    return x * step[0] + y * step[1] + z * step[2]


@compiled
def segment_box_distance(segment, box):
    """Return the distance of a segment (2, 3) from a box, m; 0 inside.

    The squared distance is a convex function of the share of the segment, and a parabola between the places where the
    segment crosses the planes of faces: at most six.
    """
    centre, half_size = box.centre, (box.half_size[0], box.half_size[1], box.half_size[2])
    ax, ay, az = segment[0, 0], segment[0, 1], segment[0, 2]
    start = in_frame(box, (ax - centre[0], ay - centre[1], az - centre[2]))
    step = in_frame(box, (segment[1, 0] - ax, segment[1, 1] - ay, segment[1, 2] - az))
    share = 0.0
    if slope(start, step, half_size, 0.0) < 0:
        low, high = 0.0, 1.0
        for i in range(3):
            for side in (-half_size[i], half_size[i]):
                crossing = (side - start[i]) / step[i] if step[i] != 0 else 0.0
                if low < crossing < high:
                    if slope(start, step, half_size, crossing) < 0:
                        low = crossing
                    else:
                        high = crossing
        at_low, at_high = slope(start, step, half_size, low), slope(start, step, half_size, high)
        share = low + (high - low) * at_low / (at_low - at_high) if at_high > 0 else high
    x, y, z = offset(start, step, half_size, share)
    return math.sqrt(x * x + y * y + z * z)


@compiled
def touches(links, pairs, on_floor, boxes, ends):
    """Return True if one of `pairs` (p, 2) of links touches, a link of `on_floor` the floor, or a moving link a box."""
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
def base_distance(links, position):
    """Return the distance (m) of a position (3,) from the links that do not move; infinite if there are none."""
    distance, segment, point = np.inf, np.empty((2, 3)), np.empty((2, 3))
    for i in range(3):
        point[:, i] = position[i]
    for link in links:
        if link.joint == 0:
            copy_to(link.start, segment[0])
            copy_to(link.end, segment[1])
            distance = min(distance, segments_distance(segment, point) - link.radius)
    return distance


@compiled
def are_free(joints, links, pairs, on_floor, boxes, q, free):
    """Compute for each of q (n, dof) whether the arm touches nothing."""
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    ends = np.empty((len(links), 2, 3))
    for row in range(len(q)):
        forward(joints, q[row], rotations, origins)
        place(links, rotations, origins, ends)
        free[row] = not touches(links, pairs, on_floor, boxes, ends)


@compiled
def are_usable(joints, links, pairs, on_floor, boxes, q, usable):
    """Compute for each of q (n, dof) whether it is within the joint limits, and the arm touches nothing."""
    for row in range(len(q)):
        usable[row] = True
        for i in range(q.shape[1]):
            usable[row] = usable[row] and joints[i].lower <= q[row, i] <= joints[i].upper
        if usable[row]:
            are_free(joints, links, pairs, on_floor, boxes, q[row : row + 1], usable[row : row + 1])


@compiled
def box_distances(joints, links, boxes, q, distances):
    """Lower `distances` (k,) m to the distance of each box from the arm at q (dof,)."""
    ends = ends_at(joints, links, q)
    for i in range(len(boxes)):
        for link in range(len(links)):
            distances[i] = min(distances[i], segment_box_distance(ends[link], boxes[i]) - links[link].radius)
