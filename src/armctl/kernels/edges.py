"""Continuous collision checks of straight joint motions: see `armctl.kinematics.edge_checker`.

Pairs are an array of `PAIR`: two links; a link's end and the floor; or a link and a box.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.kernels.capsules import ends_at, segment_box_distance, segments_distance
from armctl.kernels.compiling import compiled, copy_to
from armctl.kernels.drives import follow_all

PAIR = np.dtype([("kind", int), ("link", int), ("other", int)])
LINKS, FLOOR_END, LINK_AND_BOX = range(3)
SLACK = 1.5
"""Factor on distances at checked configurations, so that the distances themselves are kept in between."""
NEAR_START = 0.5
"""Fraction of their distance at the start that a pair must keep if it starts nearer than the clearance."""
FINEST = 2**-12
"""Finest fraction of an edge: an edge still undecided there counts as blocked, which bounds the effort."""
AT_REST = 1e-5
"""rad: joints that move less in a tick, and are so near to their goal, are at rest there."""


class Scene(NamedTuple):
    """An arm among boxes: records of its joints and links, of the pairs that may touch, and of the boxes."""

    joints: NDArray[np.void]
    links: NDArray[np.void]
    pairs: NDArray[np.void]
    boxes: NDArray[np.void]


class Bounds(NamedTuple):
    """Distances that edges keep."""

    margins: NDArray[np.float64]
    """(pairs,) m at checked configurations; `SLACK` times what is kept in between."""
    motion: NDArray[np.float64]
    """(pairs, dof) m/rad: bound on how far each joint moves a pair."""
    distances: NDArray[np.float64]
    """(checks, pairs) memory: an edge counts as blocked if it does not suffice."""


@compiled
def distance(links, boxes, ends, pair):
    """Return the distance of a pair, m; 0 or below in contact."""
    link, other = pair.link, pair.other
    if pair.kind == LINKS:
        return segments_distance(ends[link], ends[other]) - links[link].radius - links[other].radius
    if pair.kind == FLOOR_END:
        return ends[link, other, 2] - links[link].radius
    return segment_box_distance(ends[link], boxes[other]) - links[link].radius


@compiled
def measure_all(scene, q, distances):
    """Measure the `distances` (pairs,) of all pairs at q (dof,), m."""
    joints, links, pairs, boxes = scene
    ends = ends_at(joints, links, q)
    for i in range(len(pairs)):
        distances[i] = distance(links, boxes, ends, pairs[i])


@compiled
def measure(joints, links, pairs, boxes, q, margins, distances):
    """Measure `distances` (pairs,) m at q (dof,) until one is below its margin; return True if none is.

    Pairs whose distance is infinite beforehand are not measured.
    """
    ends = ends_at(joints, links, q)
    for i in range(len(pairs)):
        if distances[i] < np.inf:
            distances[i] = distance(links, boxes, ends, pairs[i])
            if distances[i] < margins[i]:
                return False
    return True


@compiled
def interpolate(a, b, share, q):
    """Compute the configuration q (dof,) at a share of the way from a to b."""
    for k in range(len(q)):
        q[k] = a[k] + share * (b[k] - a[k])


@compiled
def is_kept(first, second, margins, moved):
    """Return True if pairs with distances `first` and `second` at the ends keep theirs while they move by `moved`."""
    for i in range(len(moved)):  # noqa: SIM110 (generators cannot be compiled)
        if first[i] + second[i] < 2 * (margins[i] / SLACK) + moved[i]:
            return False
    return True


@compiled
def largest_motions(motion, num_pairs, a, b):
    """Return bounds (pairs,) m on how far the first pairs move from a to b (dof,)."""
    reach = np.zeros(num_pairs)
    for i in range(num_pairs):
        for j in range(len(a)):
            reach[i] += motion[i, j] * abs(b[j] - a[j])
    return reach


@compiled
def check_edge(scene, a, b, bounds):
    """Return whether the motion from `a` to `b` (dof,) keeps the distances of `bounds`, and the number of checks.

    It counts as blocked if spans become shorter than `FINEST`. In between, pairs that keep their margins for certain
    are not measured again.
    """
    joints, links, pairs, boxes = scene
    margins, motion, distances = bounds
    num_pairs = len(pairs)
    distances[:2] = 0.0
    if not measure(joints, links, pairs, boxes, b, margins, distances[1]):
        return False, 1
    if not measure(joints, links, pairs, boxes, a, margins, distances[0]):
        return False, 2
    reach, moved, q = largest_motions(motion, num_pairs, a, b), np.empty(num_pairs), np.empty(len(a))
    spans, rows = np.empty((2 * len(distances), 2)), np.empty((2 * len(distances), 2), np.int64)
    spans[0, 0], spans[0, 1], rows[0, 0], rows[0, 1] = 0.0, 1.0, 0, 1
    first, last, checks = 0, 1, 2
    while first < last:
        low, high = spans[first]
        at_low, at_high = rows[first]
        first += 1
        for i in range(num_pairs):
            moved[i] = reach[i] * (high - low)
        if is_kept(distances[at_low], distances[at_high], margins, moved):
            continue
        if high - low < FINEST or checks == len(distances):
            return False, checks
        middle = (low + high) / 2
        interpolate(a, b, middle, q)
        for i in range(num_pairs):
            certain = distances[at_low, i] + distances[at_high, i] >= 2 * margins[i] + moved[i]
            distances[checks, i] = np.inf if certain else 0.0
        checks += 1
        if not measure(joints, links, pairs, boxes, q, margins, distances[checks - 1]):
            return False, checks
        spans[last, 0], spans[last, 1], rows[last, 0], rows[last, 1] = low, middle, at_low, checks - 1
        spans[last + 1, 0], spans[last + 1, 1] = middle, high
        rows[last + 1, 0], rows[last + 1, 1] = checks - 1, at_high
        last += 2
    return True, checks


@compiled
def shortcut(scene, path, corners, draws, faster, bounds):
    """Try straight motions between two places of a path, in place; those are taken that save time.

    `path` (corners + draws, dof) begins with that many `corners`. Each of `draws` (k, 2) is two shares of its time at
    the velocity limits. A motion that takes less than the share `faster` of the time between its ends is taken, if it
    is free. Returns the number of corners, and the number of configurations checked.
    """
    joints = scene.joints
    times, ends, checks = np.zeros(len(path)), np.empty((2, path.shape[1])), 0
    for draw in draws:
        for i in range(1, corners):
            times[i] = times[i - 1] + cruise_time(joints, path[i - 1], path[i])
        total = times[corners - 1]
        low, high = total * min(draw[0], draw[1]), total * max(draw[0], draw[1])
        first = np.searchsorted(times[:corners], low, side="right")
        last = np.searchsorted(times[:corners], high, side="right")
        if first == last:
            continue
        for end, at, time in ((0, first, low), (1, last, high)):
            share = (time - times[at - 1]) / (times[at] - times[at - 1])
            interpolate(path[at - 1], path[at], share, ends[end])
        if cruise_time(joints, ends[0], ends[1]) >= faster * (high - low):
            continue
        free, looks = check_edge(scene, ends[0], ends[1], bounds)
        checks += looks
        if free:
            rest = path[last:corners].copy()
            corners = first + 2 + len(rest)
            for k in range(2):
                copy_to(ends[k], path[first + k])
            for k in range(len(rest)):
                copy_to(rest[k], path[first + 2 + k])
    return corners, checks


@compiled
def farthest_goal(scene, path, q, halvings, places, bounds, goal):
    """Set `goal` (dof,) to the farthest point of `path` (m, dof) to which the straight motion from `q` is free.

    Behind the last corner that is reached so, the rest of its edge is halved so many times; if none is, so many places
    of each edge are tried. Returns whether there is such a point, and the number of configurations checked.
    """
    checks, last, tried = 0, len(path) - 1, np.empty(len(q))
    for corner in range(last, -1, -1):
        free, looks = check_edge(scene, q, path[corner], bounds)
        checks += looks
        if not free:
            continue
        copy_to(path[corner], goal)
        low, high = 0.0, 1.0
        for _ in range(halvings if corner < last else 0):
            middle = (low + high) / 2
            interpolate(path[corner], path[corner + 1], middle, tried)
            free, looks = check_edge(scene, q, tried, bounds)
            checks += looks
            if free:
                low = middle
                copy_to(tried, goal)
            else:
                high = middle
        return True, checks
    for point in range(last * places - 1, 0, -1):
        corner, share = point // places, (point % places) / places
        interpolate(path[corner], path[corner + 1], share, tried)
        free, looks = check_edge(scene, q, tried, bounds)
        checks += looks
        if free:
            copy_to(tried, goal)
            return True, checks
    return False, checks


@compiled
def stops_freely(scene, position, velocity, goal, ticks, tick, max_edges, bounds):
    """Check that drives from `position` with `velocity` (dof,) keep the distances until they rest at `goal`.

    The straight motions between positions every so many `ticks` are checked, at most `max_edges` of them. Returns
    whether all are free, and the number of configurations checked.
    """
    start, current, speed, checks = position.copy(), position.copy(), velocity.copy(), 0
    for _ in range(max_edges):
        follow_all(scene.joints, goal, current, speed, ticks, tick)
        free, looks = check_edge(scene, start, current, bounds)
        checks += looks
        if not free:
            return False, checks
        if np.abs(speed).max() * tick < AT_REST and np.abs(current - goal).max() < AT_REST:
            break
        copy_to(current, start)
    return True, checks


@compiled
def cruise_time(joints, a, b):
    """Time (s) from a to b (dof,) at the velocity limit of the slowest joint."""
    time = 0.0
    for k in range(len(a)):
        time = max(time, abs(b[k] - a[k]) / joints[k].top)
    return time
