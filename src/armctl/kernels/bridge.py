"""Distances on a bridge from above: see `armctl.scene.BridgeMap`.

Blocks are rows (k, 10): the least and greatest x and y, in the order left, bottom, right, top; then the centre, the
cosine and sine of the yaw, and the half sizes; m.
"""

import math

import numpy as np

from armctl.kernels.compiling import compiled, copy_to

LESS = 1e-6
"""m: what a change of a path must save."""
WIDER = 1.5
"""Factor of a point's reach within which that of the next one is looked for first."""
ROUNDING = 1e-9
"""m: the most by which bounds of a block may be wrong."""
UNVISITED, OPEN, CLOSED = 0, 1, 2
"""States of points in a search."""


@compiled
def segment_to_block(ax, ay, bx, by, block):
    """Return the distance of a segment from a block, m; 0 if they meet.

    Separate ones are nearest at an end of the segment, or at the block's foremost corner towards it.
    """
    cos, sin, half_x, half_y = block[6], block[7], block[8], block[9]
    ax, ay, bx, by = ax - block[4], ay - block[5], bx - block[4], by - block[5]
    ax, ay, bx, by = ax * cos + ay * sin, ay * cos - ax * sin, bx * cos + by * sin, by * cos - bx * sin
    x, y, wx, wy = (ax + bx) / 2, (ay + by) / 2, (bx - ax) / 2, (by - ay) / 2
    lateral = x * wy - y * wx
    if (
        abs(x) <= half_x + abs(wx)
        and abs(y) <= half_y + abs(wy)
        and abs(lateral) <= half_x * abs(wy) + half_y * abs(wx)
    ):
        return 0.0
    corner_x, corner_y = math.copysign(half_x, lateral * wy) - x, math.copysign(half_y, -lateral * wx) - y
    share = (corner_x * wx + corner_y * wy) / max(wx * wx + wy * wy, 1e-24)
    share = min(max(share, -1.0), 1.0)
    to_corner = math.hypot(corner_x - share * wx, corner_y - share * wy)
    to_a = math.hypot(max(abs(ax) - half_x, 0.0), max(abs(ay) - half_y, 0.0))
    to_b = math.hypot(max(abs(bx) - half_x, 0.0), max(abs(by) - half_y, 0.0))
    return min(to_corner, to_a, to_b)


@compiled
def to_sides(half_width, length, x, y):
    """Return the distance (m) of a point from the nearest side or end of the deck."""
    return min(half_width - abs(y), x, length - x)


@compiled
def is_farther(block, ax, ay, bx, by, distance):
    """Return True if a segment is certainly farther than a `distance` (m) from a block; never if it may meet it."""
    ahead = max(block[0] - max(ax, bx), min(ax, bx) - block[2])
    aside = max(block[1] - max(ay, by), min(ay, by) - block[3])
    return max(ahead, aside) > max(distance, 0.0) + ROUNDING


@compiled
def clearances(blocks, half_width, length, points, out):
    """Compute the distance (n,) m of `points` (n, 2) from the nearest block, side or end; 0 or below inside a block."""
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        out[i] = to_sides(half_width, length, x, y)
        for k in range(len(blocks)):
            if is_farther(blocks[k], x, y, x, y, out[i]):
                continue
            cos, sin, dx, dy = blocks[k, 6], blocks[k, 7], x - blocks[k, 4], y - blocks[k, 5]
            beyond_x, beyond_y = abs(dx * cos + dy * sin) - blocks[k, 8], abs(dy * cos - dx * sin) - blocks[k, 9]
            outside = math.hypot(max(beyond_x, 0.0), max(beyond_y, 0.0))
            out[i] = min(out[i], outside + min(max(beyond_x, beyond_y), 0.0))


@compiled
def segment_clearances(blocks, half_width, length, starts, ends, out):
    """Compute the distances (n,) m of segments from `starts` to `ends`, (n, 2) each."""
    for i in range(len(starts)):
        ax, ay, bx, by = starts[i, 0], starts[i, 1], ends[i, 0], ends[i, 1]
        out[i] = min(to_sides(half_width, length, ax, ay), to_sides(half_width, length, bx, by))
        for k in range(len(blocks)):
            if not is_farther(blocks[k], ax, ay, bx, by, out[i]):
                out[i] = min(out[i], segment_to_block(ax, ay, bx, by, blocks[k]))


@compiled
def edge_is_free(blocks, half_width, length, clearance, ax, ay, bx, by):
    """Return True if an edge keeps a clearance from blocks, sides and ends of the deck."""
    if max(abs(ay), abs(by)) > half_width - clearance:
        return False
    if min(ax, bx) < clearance or max(ax, bx) > length - clearance:
        return False
    for k in range(len(blocks)):
        is_near = not is_farther(blocks[k], ax, ay, bx, by, clearance)
        if is_near and segment_to_block(ax, ay, bx, by, blocks[k]) < clearance:
            return False
    return True


@compiled
def pull(deck, previous, corner, following, points):
    """Move a path's `corner` (2,) to the one of `points` (n, 2) with which the path past it is shortest; whether it is.

    `deck` are the first arguments of `edge_is_free`.
    """
    ax, ay, bx, by, moved = previous[0], previous[1], following[0], following[1], False
    length = math.hypot(corner[0] - ax, corner[1] - ay) + math.hypot(bx - corner[0], by - corner[1])
    for x, y in points:
        through = math.hypot(x - ax, y - ay) + math.hypot(bx - x, by - y)
        if through < length - LESS and edge_is_free(*deck, ax, ay, x, y) and edge_is_free(*deck, x, y, bx, by):
            corner[0], corner[1], length, moved = x, y, through, True
    return moved


@compiled
def shorten(deck, path, points, ends):
    """Leave out the corners of a path (m, 2), or move them to other `points` (n, 2), while that makes it shorter.

    It may end at any of `ends` (k, 2). Returns how many corners are left.
    """
    corners, shorter = len(path), True
    while shorter:
        shorter, i = False, 1
        while i < corners - 1:
            if edge_is_free(*deck, path[i - 1, 0], path[i - 1, 1], path[i + 1, 0], path[i + 1, 1]):
                corners, shorter = corners - 1, True
                for k in range(i, corners):
                    copy_to(path[k + 1], path[k])
            else:
                shorter |= pull(deck, path[i - 1], path[i], path[i + 1], points)
                i += 1
        (ax, ay), last = path[corners - 2], path[corners - 1]
        for x, y in ends:
            nearer = math.hypot(x - ax, y - ay) < math.hypot(last[0] - ax, last[1] - ay) - LESS
            if nearer and edge_is_free(*deck, ax, ay, x, y):
                last[0], last[1], shorter = x, y, True
    return corners


@compiled
def best_parent(x, open_points, distances, costs, reach):
    """Return the open neighbour of point x through which its path is shortest, and that path's length, m.

    Of points in a line, it is the nearest: OMPL goes through neighbours in the order of their distances.
    """
    parent, min_cost = -1, np.inf
    for y in open_points:
        edge = distances[x, y]
        cost = costs[y] + edge
        if edge <= reach[x] and (cost < min_cost or (cost == min_cost and edge < distances[x, parent])):
            parent, min_cost = y, cost
    return parent, min_cost


@compiled
def measure_neighborhoods(points, neighbors, distances, reach):
    """Write `distances` (n, n) m between points (n, 2), and the `reach` (n,) m in which each has so many `neighbors`.

    A point is the first of them itself. Where there are not so many points, the reach is infinite.
    """
    n = len(points)
    for i in range(n):
        for j in range(i + 1):
            x, y = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
            distances[i, j] = distances[j, i] = math.sqrt(x * x + y * y)
    reach[:] = np.inf
    if neighbors > n:
        return
    near, within = np.empty(n), np.inf
    for i in range(n):
        count = 0
        while count < neighbors:
            count = 0
            for j in range(n):
                if distances[i, j] <= within:
                    near[count] = distances[i, j]
                    count += 1
            within = np.inf
        reach[i] = smallest(near[:count], neighbors - 1)
        within = WIDER * reach[i]


@compiled
def smallest(numbers, place):
    """Return the number that would be at a `place` if `numbers` (n,) were sorted; they change places."""
    low, high = 0, len(numbers) - 1
    while low < high:
        pivot, i, j = numbers[(low + high) // 2], low, high
        while i <= j:
            while numbers[i] < pivot:
                i += 1
            while numbers[j] > pivot:
                j -= 1
            if i <= j:
                numbers[i], numbers[j] = numbers[j], numbers[i]
                i += 1
                j -= 1
        if place <= j:
            high = j
        elif place >= i:
            low = i
        else:
            break
    return numbers[place]


@compiled
def march(deck, points, goal_x, distances, reach, parents):
    """Search `points` (n, 2) for a path from the first one to x = `goal_x` by FMT*, as OMPL does with nearest k.

    `deck` are the first arguments of `edge_is_free`, `distances` (n, n) m. Points are neighbours if both have the other
    within `reach` (n,) m. Returns the last point of the path, whose other points `parents` (n,) lead to; -1 if there is
    none.
    """
    states, costs = np.zeros(len(points), np.int8), np.zeros(len(points))
    is_blocked, open_points = np.zeros(distances.shape, np.bool_), np.zeros(len(points), np.int64)
    current, num_open = 0, 1
    while current >= 0 and points[current, 0] < goal_x:
        states[current] = CLOSED
        for x in range(len(points)):
            if states[x] != UNVISITED or distances[current, x] > min(reach[current], reach[x]):
                continue
            parent, cost = best_parent(x, open_points[:num_open], distances, costs, reach)
            is_blocked[parent, x] = is_blocked[parent, x] or not edge_is_free(
                *deck, points[parent, 0], points[parent, 1], points[x, 0], points[x, 1]
            )
            if not is_blocked[parent, x]:
                states[x], parents[x], costs[x] = OPEN, parent, cost
        current, num_open = -1, 0
        for x in range(len(points)):
            if states[x] == OPEN:
                open_points[num_open] = x
                num_open += 1
                if current < 0 or costs[x] < costs[current]:
                    current = x
    return current


@compiled
def nearest(blocks, half_width, length, points, nearest_points):
    """Write the `nearest_points` (m, k + 2, 2) of the blocks and of the two sides to points (m, 2)."""
    for i in range(len(points)):
        for k in range(len(blocks)):
            block = blocks[k]
            cos, sin = block[6], block[7]
            x, y = points[i, 0] - block[4], points[i, 1] - block[5]
            ahead = min(max(x * cos + y * sin, -block[8]), block[8])
            left = min(max(y * cos - x * sin, -block[9]), block[9])
            x, y = block[4] + (ahead * cos - left * sin), block[5] + (ahead * sin + left * cos)
            copy_to((x, y), nearest_points[i, k])
        copy_to((points[i, 0], -half_width), nearest_points[i, len(blocks)])
        copy_to((points[i, 0], half_width), nearest_points[i, len(blocks) + 1])
