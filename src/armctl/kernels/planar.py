"""A rover on a bridge as a drawing from above, without physics: see `armctl.tasks.bridge.planar`.

Blocks are rows (k, 6): centre x and y, cosine and sine of the yaw, half length and half width, m. `barriers` (2, s)
says of each segment of the left and the right side whether a barrier stands there.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.compiling import compiled

FREE, BARRIER, OBSTACLE = 0, 1, 2


class Deck(NamedTuple):
    """Sizes that all bridges share, m."""

    length: float
    half_width: float
    """Distance between the barriers' feet."""
    walker_radius: float
    edge: float
    """Distance from the middle of the deck to its edges."""


class Scenes(NamedTuple):
    """Obstacles and walkers on n bridges."""

    blocks: Array
    """(n, k, 6)."""
    barriers: NDArray[np.bool_]
    """(n, 2, segments): left and right."""
    walkers: Array
    """(n, w, 2) m."""


class Rover(NamedTuple):
    """A rover that follows commands."""

    linear: float
    """m/s^2: limit of acceleration."""
    angular: float
    """rad/s^2: limit of acceleration."""
    outline: Array
    """(k, 2) m: half lengths and half widths of the rectangles that make its outline."""


class Rovers(NamedTuple):
    """States of n rovers, each on its bridge."""

    poses: Array
    """(n, 3) x, y (m) and yaw (rad)."""
    velocities: Array
    """(n, 2) m/s and rad/s."""
    contacts: NDArray[np.int64]
    """(n,) what each touches: `FREE`, `BARRIER` or `OBSTACLE`."""


class RangeSensor(NamedTuple):
    """A sensor of distances, in lengths of its rays' directions."""

    ahead: float
    """m before the rover's centre."""
    directions: Array
    """(columns, 2) m ahead and to the left."""
    barriers: float
    """m from the middle of the deck at which barriers are seen."""
    farthest: float
    farthest_hole: float
    """Distance up to which the deck's edge is seen where a barrier is missing."""


@compiled
def towards(value, goal, max_change):
    """Move a value towards a goal by at most `max_change`."""
    return value + min(max(goal - value, -max_change), max_change)


@compiled
def barrier_at(barriers, length, side, x):
    """Return True if a barrier stands at x on a side, 0 or 1."""
    segments = barriers.shape[1]
    i = math.floor(x / length * segments)
    return 0 <= i < segments and barriers[side, i]


@compiled
def apart(x, y, cos, sin, half_x, half_y, block):
    """Return True if one of the four axes of a rectangle at x, y and of a block separates them."""
    dx, dy = block[0] - x, block[1] - y
    cross, dot = abs(cos * block[3] - sin * block[2]), abs(cos * block[2] + sin * block[3])
    if abs(dx * cos + dy * sin) > half_x + block[4] * dot + block[5] * cross:
        return True
    if abs(dy * cos - dx * sin) > half_y + block[4] * cross + block[5] * dot:
        return True
    if abs(dx * block[2] + dy * block[3]) > block[4] + half_x * dot + half_y * cross:
        return True
    return abs(dy * block[2] - dx * block[3]) > block[5] + half_x * cross + half_y * dot


@compiled
def touched(deck, blocks, barriers, walkers, x, y, yaw, outline):
    """Return what a rover at a pose touches: `FREE`, `BARRIER` (blocks too, as in MuJoCo's model) or `OBSTACLE`."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    for half_x, half_y in outline:
        for ahead in (-half_x, half_x):
            for left in (-half_y, half_y):
                corner_y = y + ahead * sin + left * cos
                if abs(corner_y) > deck.half_width:
                    side = 0 if corner_y > 0 else 1
                    if barrier_at(barriers, deck.length, side, x + ahead * cos - left * sin):
                        return BARRIER
        for k in range(len(blocks)):
            if not apart(x, y, cos, sin, half_x, half_y, blocks[k]):
                return BARRIER
        for k in range(len(walkers)):
            dx, dy = walkers[k, 0] - x, walkers[k, 1] - y
            beyond_x = max(abs(dx * cos + dy * sin) - half_x, 0.0)
            beyond_y = max(abs(dy * cos - dx * sin) - half_y, 0.0)
            if beyond_x * beyond_x + beyond_y * beyond_y < deck.walker_radius * deck.walker_radius:
                return OBSTACLE
    return FREE


@compiled
def drive(ids, deck, scenes, rover, places, period, commands, rovers):
    """Drive rovers `ids` by `commands` (n, 2) for one control step of `period` s.

    `places` (ticks, n, w, 2) are the walkers' in the ticks. A rover stops where it touches something.
    """
    poses, velocities, contacts = rovers
    blocks, barriers, _ = scenes
    ticks, outline = len(places), rover.outline
    tick = period / ticks
    for i in ids:
        contacts[i] = FREE
        for k in range(ticks):
            linear = towards(velocities[i, 0], commands[i, 0], rover.linear * tick)
            angular = towards(velocities[i, 1], commands[i, 1], rover.angular * tick)
            yaw = poses[i, 2] + angular * tick / 2
            poses[i, 0] += linear * math.cos(yaw) * tick
            poses[i, 1] += linear * math.sin(yaw) * tick
            poses[i, 2] = (poses[i, 2] + angular * tick + math.pi) % (2 * math.pi) - math.pi
            velocities[i, 0], velocities[i, 1] = linear, angular
            x, y, yaw = poses[i, 0], poses[i, 1], poses[i, 2]
            contacts[i] = touched(deck, blocks[i], barriers[i], places[k, i], x, y, yaw, outline)
            if contacts[i] != FREE:
                break


@compiled
def to_block(x, y, dx, dy, block):
    """Return the length of a ray, in lengths of its direction, to a block; infinite if it misses."""
    ox, oy = x - block[0], y - block[1]
    ax, ay = ox * block[2] + oy * block[3], oy * block[2] - ox * block[3]
    bx, by = dx * block[2] + dy * block[3], dy * block[2] - dx * block[3]
    enter, leave = -np.inf, np.inf
    for start, along, half in ((ax, bx, block[4]), (ay, by, block[5])):
        if abs(along) < 1e-12:
            if abs(start) > half:
                return np.inf
        else:
            first, second = (-half - start) / along, (half - start) / along
            enter, leave = max(enter, min(first, second)), min(leave, max(first, second))
    return max(enter, 0.0) if enter <= leave and leave >= 0 else np.inf


@compiled
def to_disc(x, y, dx, dy, centre, radius):
    """Return the length of a ray to a disc, as `to_block` does."""
    ox, oy = x - centre[0], y - centre[1]
    a, b, c = dx * dx + dy * dy, ox * dx + oy * dy, ox * ox + oy * oy - radius * radius
    if c <= 0:
        return 0.0
    discriminant = b * b - a * c
    if discriminant < 0 or b > 0:
        return np.inf
    return (-b - math.sqrt(discriminant)) / a


@compiled
def to_side(deck, barriers, x, y, dx, dy, half_width, farthest_hole):
    """Return the length of a ray to the barriers along both sides, at `half_width` from the middle of the deck.

    Where one is missing, the ray ends at the deck's edge if that is at most `farthest_hole` away.
    """
    if abs(dy) < 1e-12:
        return np.inf
    side, sign = (0, 1.0) if dy > 0 else (1, -1.0)
    distance = (sign * half_width - y) / dy
    if barrier_at(barriers, deck.length, side, x + distance * dx):
        return max(distance, 0.0)
    distance = (sign * deck.edge - y) / dy
    return max(distance, 0.0) if distance <= farthest_hole else np.inf


@compiled
def scan(ids, deck, scenes, sensor, poses, out):
    """Compute the ranges (k, columns) that a sensor measures on rovers `ids` (k,) at `poses` (n, 3)."""
    blocks, barriers, walkers = scenes
    directions = sensor.directions
    for j in range(len(ids)):
        i = ids[j]
        cos, sin = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        x, y = poses[i, 0] + sensor.ahead * cos, poses[i, 1] + sensor.ahead * sin
        for c in range(len(directions)):
            ahead, left = directions[c]
            dx, dy = ahead * cos - left * sin, ahead * sin + left * cos
            to_barrier = to_side(deck, barriers[i], x, y, dx, dy, sensor.barriers, sensor.farthest_hole)
            nearest = min(sensor.farthest, to_barrier)
            for k in range(blocks.shape[1]):
                nearest = min(nearest, to_block(x, y, dx, dy, blocks[i, k]))
            for k in range(walkers.shape[1]):
                nearest = min(nearest, to_disc(x, y, dx, dy, walkers[i, k], deck.walker_radius))
            out[j, c] = nearest
