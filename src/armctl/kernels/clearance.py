"""Distances of an arm's links and their gradients, for controllers: see `armctl.kinematics.clearance`.

Distances of a link and a box are those of points along the link, and negative inside the box, so that they have a
gradient everywhere.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.kernels.arm import axes_of, forward, gradient_of
from armctl.kernels.capsules import ends_at, place, segments_distance, shares_on_segments
from armctl.kernels.compiling import compiled, copy_to
from armctl.kernels.edges import FLOOR_END, LINKS


class ScaledScene(NamedTuple):
    """An arm among boxes: records of its joints and links, of the pairs that may touch, and of the boxes."""

    joints: NDArray[np.void]
    links: NDArray[np.void]
    pairs: NDArray[np.void]
    boxes: NDArray[np.void]
    samples: NDArray[np.int64]
    """(links,) number of points along each link."""
    scales: NDArray[np.float64]
    """(pairs,) factors of all distances."""


@compiled
def point_on(segment, share, out):
    """Compute the point of a segment (2, 3) at a share of it."""
    for i in range(3):
        out[i] = segment[0, i] + share * (segment[1, i] - segment[0, i])


@compiled
def box_distance(point, box):
    """Return the signed distance of a point (3,) from a box, m: negative inside."""
    square, inside = 0.0, -np.inf
    for i in range(3):
        local = 0.0
        for j in range(3):
            local += box.rotation[j, i] * (point[j] - box.centre[j])
        beyond = abs(local) - box.half_size[i]
        inside = max(inside, beyond)
        square += max(beyond, 0.0) ** 2
    return math.sqrt(square) + min(inside, 0.0)


@compiled
def box_normal(point, box, out):
    """Compute the outward unit vector of a box towards a point (3,); inside, that of the nearest face."""
    away, inside, square = np.zeros(3), -np.inf, 0.0
    face, side = 0, 1.0
    for i in range(3):
        local = 0.0
        for j in range(3):
            local += box.rotation[j, i] * (point[j] - box.centre[j])
        beyond = abs(local) - box.half_size[i]
        if beyond > inside:
            inside, face, side = beyond, i, math.copysign(1.0, local)
        if beyond > 0:
            away[i] = math.copysign(beyond, local)
            square += beyond * beyond
    if square > 0:
        for i in range(3):
            away[i] /= math.sqrt(square)
    else:
        away[face] = side
    for i in range(3):
        out[i] = box.rotation[i, 0] * away[0] + box.rotation[i, 1] * away[1] + box.rotation[i, 2] * away[2]


@compiled
def nearest_sample(segment, samples, box):
    """Return the share of a segment at which one of its evenly spaced points is nearest to a box, and that distance."""
    point, nearest, min_distance = np.empty(3), 0.0, np.inf
    for k in range(samples):
        share = k / max(samples - 1, 1)
        point_on(segment, share, point)
        distance = box_distance(point, box)
        if distance < min_distance:
            nearest, min_distance = share, distance
    return nearest, min_distance


@compiled
def measure(links, pairs, boxes, samples, scales, ends, out):
    """Compute the distances (pairs,) of all pairs, m; return the least."""
    min_distance = np.inf
    for i in range(len(pairs)):
        kind, link, other = pairs[i].kind, pairs[i].link, pairs[i].other
        if kind == LINKS:
            out[i] = segments_distance(ends[link], ends[other]) - links[link].radius - links[other].radius
        elif kind == FLOOR_END:
            out[i] = ends[link, other, 2] - links[link].radius
        else:
            out[i] = nearest_sample(ends[link], samples[link], boxes[other])[1] - links[link].radius
        out[i] *= scales[i]
        min_distance = min(min_distance, out[i])
    return min_distance


@compiled
def add_motion(chain, joint, point, normal, sign, row):
    """Add to `row` (dof,) how fast joints move a point (3,) of the frame of `joint` along a normal (3,), m/rad."""
    joints, axes, origins = chain
    for k in range(joint):
        x, y, z = gradient_of(joints[k], axes[k], origins[k], point)
        along = normal[0] * x + normal[1] * y + normal[2] * z
        row[joints[k].motor] += joints[k].ratio * sign * along


@compiled
def gradient(links, pair, boxes, samples, ends, chain, row):
    """Compute the gradient (dof,) of a pair's distance without its scale, m/rad; `chain`: joints, axes, origins."""
    point, foot, normal = np.empty(3), np.empty(3), np.zeros(3)
    row[:] = 0.0
    if pair.kind == LINKS:
        share, other = shares_on_segments(ends[pair.link], ends[pair.other])
        point_on(ends[pair.link], share, point)
        point_on(ends[pair.other], other, foot)
        length = 0.0
        for i in range(3):
            normal[i] = point[i] - foot[i]
            length += normal[i] * normal[i]
        for i in range(3):
            normal[i] /= max(math.sqrt(length), 1e-9)
        add_motion(chain, links[pair.other].joint, foot, normal, -1.0, row)
    elif pair.kind == FLOOR_END:
        copy_to(ends[pair.link, pair.other], point)
        normal[2] = 1.0
    else:
        point_on(ends[pair.link], nearest_sample(ends[pair.link], samples[pair.link], boxes[pair.other])[0], point)
        box_normal(point, boxes[pair.other], normal)
    add_motion(chain, links[pair.link].joint, point, normal, 1.0, row)


@compiled
def clearances(scene, q, min_distances):
    """Compute the least distance of all pairs, (n,) m, at each of q (n, dof)."""
    joints, links, pairs, boxes, samples, scales = scene
    distances = np.empty(len(pairs))
    for row in range(len(q)):
        ends = ends_at(joints, links, q[row])
        min_distances[row] = measure(links, pairs, boxes, samples, scales, ends, distances)


@compiled
def nearest_pairs(scene, q, distances, gradients):
    """Compute `distances` (n, m) of the m nearest pairs at each of q (n, dof), in the order of pairs, and `gradients`.

    Distances of pairs that are missing are infinite, and gradients zero.
    """
    joints, links, pairs, boxes, samples, scales = scene
    frames, dof, count = len(joints), q.shape[1], distances.shape[1]
    rotations, origins, axes = np.empty((frames, 3, 3)), np.empty((frames, 3)), np.empty((frames, 3))
    ends, pair_distances = np.empty((len(links), 2, 3)), np.empty(len(pairs))
    for row in range(len(q)):
        forward(joints, q[row], rotations, origins)
        axes_of(joints, rotations, axes)
        place(links, rotations, origins, ends)
        measure(links, pairs, boxes, samples, scales, ends, pair_distances)
        distances[row], gradients[row] = np.inf, 0.0
        furthest = np.sort(pair_distances)[count - 1] if count <= len(pairs) else np.inf
        column = 0
        for i in range(len(pairs)):
            if pair_distances[i] <= furthest and column < count:
                distances[row, column] = pair_distances[i]
                gradient(links, pairs[i], boxes, samples, ends, (joints, axes, origins), gradients[row, column])
                for k in range(dof):
                    gradients[row, column, k] *= scales[i]
                column += 1
