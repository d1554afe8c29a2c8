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
def clearance_at(blocks, half_width, length, x, y):
    """Return the distance (m) of a point from the nearest block, side or end; 0 or below inside a block."""
    clearance = to_sides(half_width, length, x, y)
    for k in range(len(blocks)):
        if is_farther(blocks[k], x, y, x, y, clearance):
            continue
        cos, sin, dx, dy = blocks[k, 6], blocks[k, 7], x - blocks[k, 4], y - blocks[k, 5]
        beyond_x, beyond_y = abs(dx * cos + dy * sin) - blocks[k, 8], abs(dy * cos - dx * sin) - blocks[k, 9]
        outside = math.hypot(max(beyond_x, 0.0), max(beyond_y, 0.0))
        clearance = min(clearance, outside + min(max(beyond_x, beyond_y), 0.0))
    return clearance


@compiled
def clearances(blocks, half_width, length, points, out):
    """Compute the distance (n,) m of `points` (n, 2) from the nearest block, side or end; 0 or below inside a block."""
    for i in range(len(points)):
        out[i] = clearance_at(blocks, half_width, length, points[i, 0], points[i, 1])


@compiled
def segment_clearance(blocks, half_width, length, ax, ay, bx, by):
    """Return the distance (m) of a segment from the nearest block, side or end."""
    clearance = min(to_sides(half_width, length, ax, ay), to_sides(half_width, length, bx, by))
    for k in range(len(blocks)):
        if not is_farther(blocks[k], ax, ay, bx, by, clearance):
            clearance = min(clearance, segment_to_block(ax, ay, bx, by, blocks[k]))
    return clearance


@compiled
def segment_clearances(blocks, half_width, length, starts, ends, out):
    """Compute the distances (n,) m of segments from `starts` to `ends`, (n, 2) each."""
    for i in range(len(starts)):
        ax, ay, bx, by = starts[i, 0], starts[i, 1], ends[i, 0], ends[i, 1]
        out[i] = segment_clearance(blocks, half_width, length, ax, ay, bx, by)


@compiled
def first_open(blocked, clearance, deck, room, start, offsets):
    """Return the first of `offsets` (n, 2) from `start` (2,) with a clearance on deck `blocked`; -1 if there is none.

    The segment to it keeps `room` on another `deck`. Decks are the first arguments of `clearance_at`.
    """
    for i in range(len(offsets)):
        x, y = start[0] + offsets[i, 0], start[1] + offsets[i, 1]
        is_open = clearance_at(*blocked, x, y) >= clearance
        if is_open and segment_clearance(*deck, start[0], start[1], x, y) >= room:
            return i
    return -1


@compiled
def may_pass(deck, clearance, start, goal_x, cell):
    """Return False if certainly no path with a clearance leads from `start` (2,) to x = `goal_x`, m.

    A path leads from cell to cell of a grid, and comes near the centre of each: so these lack at most that distance of
    the clearance.
    """
    _, half_width, length = deck
    nx, ny = math.ceil(length / cell), math.ceil(2 * half_width / cell)
    visited, stack, height = np.zeros((nx, ny), np.bool_), np.empty((nx * ny, 2), np.int64), 1
    stack[0, 0] = min(max(math.floor(start[0] / cell), 0), nx - 1)
    stack[0, 1] = min(max(math.floor((start[1] + half_width) / cell), 0), ny - 1)
    min_clearance, last = clearance - cell * math.sqrt(0.5) - ROUNDING, math.floor((goal_x - ROUNDING) / cell)
    visited[stack[0, 0], stack[0, 1]] = True
    while height > 0:
        height -= 1
        i, j = stack[height, 0], stack[height, 1]
        if i >= last:
            return True
        for to_i in range(max(i - 1, 0), min(i + 2, nx)):
            for to_j in range(max(j - 1, 0), min(j + 2, ny)):
                if visited[to_i, to_j]:
                    continue
                visited[to_i, to_j] = True
                x, y = (to_i + 0.5) * cell, (to_j + 0.5) * cell - half_width
                if clearance_at(*deck, x, y) >= min_clearance:
                    stack[height, 0], stack[height, 1] = to_i, to_j
                    height += 1
    return False


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
def best_parent(x, points, open_points, costs, reach):
    """Return the open neighbour of point x through which its path is shortest, and that path's length, m.

    Of points in a line, it is the nearest: OMPL goes through neighbours in the order of their distances.
    """
    parent, min_cost, nearest = -1, np.inf, np.inf
    for y in open_points:
        dx, dy = points[x, 0] - points[y, 0], points[x, 1] - points[y, 1]
        edge = math.sqrt(dx * dx + dy * dy)
        cost = costs[y] + edge
        if edge <= reach and (cost < min_cost or (cost == min_cost and edge < nearest)):
            parent, min_cost, nearest = y, cost, edge
    return parent, min_cost


@compiled
def measure(points, i, distances):
    """Compute the `distances` (n,) of points (n, 2) from the i-th, m."""
    for j in range(len(points)):
        dx, dy = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
        distances[j] = math.sqrt(dx * dx + dy * dy)


@compiled
def reach_among(distances, neighbors, within, near):
    """Return the distance (m) of the point with so many `neighbors` among points at `distances` (n,), itself included.

    Without so many points, it is infinite. It is looked for `within` a distance first; `near` (n,) is scratch.
    """
    if neighbors > len(distances):
        return np.inf
    count = 0
    while count < neighbors:
        count = 0
        for distance in distances:
            if distance <= within:
                near[count] = distance
                count += 1
        within = np.inf
    return smallest(near[:count], neighbors - 1)


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
def march(deck, points, goal_x, neighbors, parents):
    """Search `points` (n, 2) for a path from the first one to x = `goal_x` by FMT*, as OMPL does with nearest k.

    `deck` are the first arguments of `edge_is_free`. Points are neighbours if each is one of so many `neighbors` of the
    other. Returns the last point of the path, whose other points `parents` (n,) lead to; -1 if there is none.
    """
    n = len(points)
    states, costs, open_points = np.zeros(n, np.int8), np.zeros(n), np.zeros(n, np.int64)
    reach, blocked_from = np.full(n, -1.0), np.full(n, -1)  # both are unknown
    to_current, to_point, near, within = np.empty(n), np.empty(n), np.empty(n), np.inf
    current, num_open = 0, 1
    while current >= 0 and points[current, 0] < goal_x:
        states[current] = CLOSED
        measure(points, current, to_current)
        if reach[current] < 0:
            reach[current] = reach_among(to_current, neighbors, within, near)
        for x in range(n):
            if states[x] != UNVISITED or to_current[x] > reach[current]:
                continue
            if reach[x] < 0:
                measure(points, x, to_point)
                reach[x] = reach_among(to_point, neighbors, within, near)
                within = WIDER * reach[x]
            if to_current[x] > reach[x]:
                continue
            parent, cost = best_parent(x, points, open_points[:num_open], costs, reach[x])
            if parent == blocked_from[x]:
                continue
            if edge_is_free(*deck, points[parent, 0], points[parent, 1], points[x, 0], points[x, 1]):
                states[x], parents[x], costs[x] = OPEN, parent, cost
            else:
                blocked_from[x] = parent
        current, num_open = list_open(states, costs, open_points)
    return current


@compiled
def list_open(states, costs, open_points):
    """Write the points in state `OPEN`; return the one with the least costs, -1 if there is none, and how many."""
    cheapest, count = -1, 0
    for x in range(len(states)):
        if states[x] == OPEN:
            open_points[count] = x
            count += 1
            if cheapest < 0 or costs[x] < costs[cheapest]:
                cheapest = x
    return cheapest, count


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
