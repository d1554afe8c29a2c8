"""The arithmetic of `armctl.control.drive_mpc`: what its problem is told, and guesses of its solution.

Plans of N periods are knots, rows (N + 1, 8): x, y (m), yaw (rad), linear (m/s) and angular velocity (rad/s), then the
linear and angular acceleration until the next knot, and the slack (m).
"""

import math

import numpy as np

from armctl.kernels.arc_path import rounded
from armctl.kernels.compiling import compiled, copy_to
from armctl.kernels.planar import towards

NAMES = "max_turn_rate", "max_acceleration", "clearance", "distance", "period", "off_path", "intrusion"
"""Fields of `DriveMpcOptions` needed here, as records `OPTIONS`."""
OPTIONS = np.dtype([(name, float) for name in NAMES])
NOWHERE = 100.0
"""m: offset at which missing obstacles and pedestrians are placed."""
SMOOTHING = 0.3
"""m: corners of the path are rounded over this length in both directions."""
SIDESTEP = 0.5
"""s: time constant with which guesses approach their offsets."""


@compiled
def follow_path(segments, arcs, reference):
    """Compute points of the path and its directions at arc lengths (m,): rows (m, 4)."""
    for k in range(len(arcs)):
        copy_to(rounded(segments, arcs[k], SMOOTHING), reference[k])


@compiled
def leave_obstacles(points, obstacles, refuge):
    """Move those of points (m, 2) that are inside an obstacle to rows of `refuge`; return whether there are any.

    `obstacles` (m, k, 2) are the nearest points of obstacles: of one around a point, the point itself.
    """
    moved = False
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        for k in range(obstacles.shape[1]):
            if math.hypot(obstacles[i, k, 0] - x, obstacles[i, k, 1] - y) < 1e-3:
                points[i, 0], points[i, 1] = refuge[i, 0], refuge[i, 1]
                moved = True
                break
    return moved


@compiled
def choose(others, x, y, chosen):
    """Write those of `others` (k, 2) closest to x, y into `chosen` (c, 2), the closest first. Missing ones are far."""
    distances = np.full(len(chosen), np.inf)
    chosen[:, 0], chosen[:, 1] = x + NOWHERE, y + NOWHERE
    for i in range(len(others)):
        distance = (others[i, 0] - x) ** 2 + (others[i, 1] - y) ** 2
        place = len(chosen)
        while place > 0 and distance < distances[place - 1]:
            place -= 1
            if place + 1 < len(chosen):
                distances[place + 1] = distances[place]
                copy_to(chosen[place], chosen[place + 1])
        if place < len(chosen):
            distances[place] = distance
            copy_to(others[i], chosen[place])


@compiled
def separate(points, obstacles, planes):
    """Compute half-planes that contain points (m, 2) and exclude the obstacles with nearest points (m, k, 2).

    `planes` (m, c, 3) of the c closest are normals n and offsets o: n p > o on the point's side.
    """
    chosen = np.empty((planes.shape[1], 2))
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        choose(obstacles[i], x, y, chosen)
        for k in range(len(chosen)):
            to_x, to_y = x - chosen[k, 0], y - chosen[k, 1]
            length = max(math.hypot(to_x, to_y), 1e-9)
            to_x, to_y = to_x / length, to_y / length
            copy_to((to_x, to_y, to_x * chosen[k, 0] + to_y * chosen[k, 1]), planes[i, k])


@compiled
def choose_people(points, people, chosen):
    """Write the `chosen` (m, c, 2) of people (m, w, 2) closest to points (m, 2)."""
    for i in range(len(points)):
        choose(people[i], points[i, 0], points[i, 1], chosen[i])


@compiled
def drive_beside(options, segments, start, progress, speeds, offsets, points, costs):
    """Compute drives from a state (5,) at arc length `progress`, at each of `speeds` and `offsets` from the path.

    `points` (speeds, offsets, N + 2, 2) are where they are after each period, and then a metre ahead; `costs` (speeds,
    offsets) are those of their offsets and progress.
    """
    x, y, ahead_x, ahead_y = rounded(segments, progress, SMOOTHING)
    beginning = ahead_x * (start[1] - y) - ahead_y * (start[0] - x)
    costs[:] = 0.0
    for i in range(len(speeds)):
        arc, speed = progress, start[3]
        for k in range(points.shape[2] - 1):
            previous_speed, time = speed, k * options.period
            speed = towards(start[3], speeds[i], options.max_acceleration * time)
            arc += options.period * (previous_speed + speed) / 2 if k > 0 else 0.0
            x, y, ahead_x, ahead_y = rounded(segments, arc, SMOOTHING)
            for j in range(len(offsets)):
                offset = offsets[j] + (beginning - offsets[j]) * math.exp(-time / SIDESTEP)
                beside_x, beside_y = x - offset * ahead_y, y + offset * ahead_x
                copy_to((beside_x, beside_y), points[i, j, k])
                copy_to((beside_x + ahead_x, beside_y + ahead_y), points[i, j, k + 1])
                costs[i, j] += options.off_path * offset**2 - arc


@compiled
def intrude(options, points, obstacles, people, costs):
    """Add the price of intrusions to the `costs` (d,) of drives with `points` (d, N + 2, 2).

    `obstacles` (d, N + 2, k, 2) are the nearest points of obstacles, `people` (N + 1, w, 2) where pedestrians are.
    """
    for drive in range(len(points)):
        for k in range(len(people)):
            x, y, room = points[drive, k, 0], points[drive, k, 1], 0.0
            for i in range(obstacles.shape[2]):
                nearest = obstacles[drive, k, i]
                room = min(room, math.hypot(nearest[0] - x, nearest[1] - y) - options.clearance)
            for i in range(people.shape[1]):
                room = min(room, math.hypot(people[k, i, 0] - x, people[k, i, 1] - y) - options.distance)
            costs[drive] -= options.intrusion * room


@compiled
def drive_through(options, start, target_speed, points, knots):
    """Compute the knots of a drive from a state (5,) through points (N + 2, 2), at `target_speed`, facing ahead."""
    last, raw = len(knots) - 1, start[2]
    knots[:] = 0.0
    knots[0, 2] = raw
    for k in range(1, last + 1):
        previous_yaw = raw
        raw = math.atan2(points[k + 1, 1] - points[k, 1], points[k + 1, 0] - points[k, 0])
        turn = raw - previous_yaw
        knots[k, 2] = knots[k - 1, 2] + turn - 2 * math.pi * round(turn / (2 * math.pi))
        knots[k, 0], knots[k, 1] = points[k, 0], points[k, 1]
        knots[k, 3] = towards(start[3], target_speed, options.max_acceleration * options.period * k)
    for k in range(1, last + 1):
        following = min(k + 1, last)
        rate = (knots[following, 2] - knots[k - 1, 2]) / ((following - k + 1) * options.period)
        knots[k, 4] = min(max(rate, -options.max_turn_rate), options.max_turn_rate)
    copy_to(start, knots[0, :5])


@compiled
def shift(start, plan, period, knots):
    """Compute a plan's knots (N + 1, 8) one period later, from a state (5,), with its last velocities at the end."""
    last = len(plan) - 1
    turns = 2 * math.pi * round((start[2] - plan[1, 2]) / (2 * math.pi))
    for k in range(last + 1):
        copy_to(plan[min(k + 1, last)], knots[k])
    knots[last, 0] += period * plan[last, 3] * math.cos(plan[last, 2])
    knots[last, 1] += period * plan[last, 3] * math.sin(plan[last, 2])
    knots[last, 2] += period * plan[last, 4]
    knots[:, 2] += turns
    copy_to(start, knots[0, :5])


@compiled
def farthest_apart(first, second):
    """Return the greatest distance (m) between the positions of two plans at the same time."""
    apart = 0.0
    for k in range(len(first)):
        apart = max(apart, math.hypot(first[k, 0] - second[k, 0], first[k, 1] - second[k, 1]))
    return apart
