"""What the kernels of paths, bridges and their controller compute, in NumPy: for reading, and to hold them to."""

import numpy as np


class Path:
    """A polyline (m, 2) parametrised by arc length, extended straight beyond its ends."""

    def __init__(self, points):
        self.points = np.array(points)
        steps = np.diff(self.points, axis=0)
        self.arc = np.concatenate(([0.0], np.cumsum(np.linalg.norm(steps, axis=1))))
        self.directions = steps / np.diff(self.arc)[:, None]

    def points_at(self, arcs):
        segment = np.clip(np.searchsorted(self.arc, arcs, side="right") - 1, 0, len(self.directions) - 1)
        return self.points[segment] + self.directions[segment] * (arcs - self.arc[segment])[..., None]

    def nearest(self, points, low, high, spacing):
        """Arc lengths, of those about `spacing` apart, nearest to points (m, 2)."""
        arcs = np.linspace(low, high, round((high - low) / spacing) + 1)
        return arcs[np.linalg.norm(points[:, None] - self.points_at(arcs), axis=-1).argmin(axis=-1)]

    def rounded(self, arcs, reach):
        """Points with corners rounded over `reach`, and directions."""
        spread = reach * np.linspace(-1, 1, 5)
        chord = self.points_at(arcs + reach) - self.points_at(arcs - reach)
        length = np.linalg.norm(chord, axis=-1, keepdims=True)
        return self.points_at(arcs[..., None] + spread).mean(axis=-2), chord / np.maximum(length, 1e-9)


def nearest_on_bridge(bridge, points):
    """The point of each block and of the two sides nearest to each of points (m, 2): (m, k + 2, 2)."""
    cos, sin = np.cos(bridge.blocks[:, 2]), np.sin(bridge.blocks[:, 2])
    turns = np.stack((np.stack((cos, -sin), axis=-1), np.stack((sin, cos), axis=-1)), axis=-2)  # (k, 2, 2)
    within = np.einsum("kji,mkj->mki", turns, points[:, None] - bridge.blocks[:, :2])
    within = np.clip(within, -bridge.blocks[:, 3:], bridge.blocks[:, 3:])
    on_blocks = bridge.blocks[:, :2] + np.einsum("kij,mkj->mki", turns, within)
    on_sides = np.stack(np.broadcast_arrays(points[:, :1], (-bridge.half_width, bridge.half_width)), axis=-1)
    return np.concatenate((on_blocks, on_sides), axis=1)


def closest(count, others, points, away):
    """The `count` of others (m, k, 2) closest to points (m, 2), padded with points far away: (m, count, 2)."""
    order = np.argsort(np.linalg.norm(others - points[:, None], axis=-1), axis=1)[:, :count]
    found = np.take_along_axis(others, order[..., None], axis=1)
    return np.concatenate((found, np.repeat(points[:, None] + away, count - found.shape[1], axis=1)), axis=1)


def planes(count, obstacles, points, away):
    """Half-planes (m, count, 3) between points (m, 2) and obstacles (m, k, 2)."""
    nearest = closest(count, obstacles, points, away)
    offset = points[:, None] - nearest
    normal = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-9)
    return np.concatenate((normal, (normal * nearest).sum(axis=-1, keepdims=True)), axis=-1)


def drives(options, path, smoothing, start, progress, speeds, offsets, sidestep):
    """Points (d, steps + 1, 2) of all drives, their speeds and directions there, and the costs of their places."""
    clock = options.period * np.arange(options.steps + 1)
    reached = options.max_acceleration * clock
    speed = start[3] + np.clip(np.repeat(speeds, len(offsets))[:, None] - start[3], -reached, reached)
    moves = np.pad((speed[:, 1:] + speed[:, :-1]) / 2, ((0, 0), (1, 0)))
    arc = progress + np.cumsum(options.period * moves, axis=1)
    middle, ahead = path.rounded(arc, smoothing)
    left = np.stack((-ahead[..., 1], ahead[..., 0]), axis=-1)
    offset, goal = left[0, 0] @ (start[:2] - middle[0, 0]), np.tile(offsets, len(speeds))[:, None]
    beside = goal + (offset - goal) * np.exp(-clock / sidestep)
    return middle + beside[..., None] * left, speed, ahead, (options.off_path * beside**2 - arc).sum(axis=1)


def intrusions(options, points, obstacles, people):
    """How far drives (d, steps + 1, 2) intrude, in total, m."""
    to_obstacles = np.linalg.norm(obstacles - points[:, :, None], axis=-1).min(axis=-1, initial=np.inf)
    to_people = np.linalg.norm(people - points[:, :, None], axis=-1).min(axis=-1, initial=np.inf)
    room = np.minimum(to_obstacles - options.clearance, to_people - options.distance)
    return np.maximum(0.0, -room).sum(axis=1)


def states(options, start, points, speed, ahead):
    """States (steps + 1, 5) of a drive that points ahead at all times."""
    steps = np.diff(points, axis=0, append=points[-1:] + ahead[-1:])
    yaw = np.unwrap(np.concatenate((start[2:3], np.arctan2(steps[1:, 1], steps[1:, 0]))))
    turning = np.clip(np.gradient(yaw, options.period), -options.max_turn_rate, options.max_turn_rate)
    return np.vstack((start, np.column_stack((points, yaw, speed, turning))[1:]))


def shifted(start, plan, period):
    """A plan (steps + 1, 8) one period later."""
    yaw, speed, turn_rate = plan[-1, 2:5]
    beyond = plan[-1] + np.pad(period * np.array((speed * np.cos(yaw), speed * np.sin(yaw), turn_rate)), (0, 5))
    knots = np.vstack((plan[1:], beyond))
    knots[:, 2] += 2 * np.pi * np.round((start[2] - plan[1, 2]) / (2 * np.pi))
    knots[0, :5] = start
    return knots
