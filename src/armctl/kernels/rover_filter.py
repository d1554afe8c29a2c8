"""Arithmetic of the safety filter of rovers: see `armctl.control.rover_filter`.

A rover is a rigid body on four wheels that slide: each pushes it against its slip by Coulomb friction, and its motor
turns it towards its commanded speed. A state is (10,): x, y (m), yaw (rad), velocity in x and y (m/s), turn rate
(rad/s), and the rim speeds (m/s) of the wheels, front left, front right, rear left and rear right.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.bridge import segment_to_block
from armctl.kernels.compiling import compiled, copy_to

HOLD, ALONG, BRAKE = range(3)
"""Ways to go on before braking: with the same command, along the bridge, or not at all."""
SUBSTEPS, CHECKED = 20, 5
"""Substeps of a period, and substeps between two places at which distances are measured: 5 cm at 2 m/s."""
STEERING = 2.0
"""1/s: turn rate per yaw of a rover that drives along the bridge."""
STANDING = 0.03
"""m/s: a rover whose corners and rims are slower stands."""
MAX_PERIODS = 14
"""Periods after which a braking rover that still moves counts as unsafe."""
ENOUGH = 0.15
"""m: clearance from which on more is no better."""
BETTER = 0.005
"""m of clearance by which another way has to be better."""


class Rover(NamedTuple):
    """A rover; lengths in m."""

    wheels: Array
    """(4, 2) ahead and to the left."""
    outline: Array
    """(k, 2) half lengths and half widths of the rectangles that it is made of."""
    inertia: float
    """m^2: moment of inertia about the vertical per mass."""
    grip: float
    """m/s^2: friction per mass."""
    slip: float
    """m/s: slip from which on friction is full."""
    rim_acceleration: float
    """m/s^2: what a motor gives to the rim of a wheel that is off the ground."""
    rim_friction: float
    """m/s^2: what full friction gives to it."""
    max_rim_speed: float
    half_track: float
    """m, with skidding: rim speed = linear -+ this x angular velocity."""
    max_velocity: Array
    """(2,) m/s and rad/s."""
    period: float
    """s."""


class Surroundings(NamedTuple):
    """Surroundings of a rover on a bridge; lengths in m."""

    blocks: NDArray[np.float64]
    """Blocks, as in `armctl.kernels.bridge`."""
    half_width: float
    length: float
    people: Array
    """(ticks, w, 2) each time that distances are measured, from now on."""
    lanes: Array
    """(w, 4) ends of the lines on which they walk."""
    radius: float
    """m: radius of each."""
    margin: float
    """m kept from everything that stands."""
    people_margin: float
    """m kept from people now."""
    drift: float
    """m/s by which this margin grows with time."""


class Backup(NamedTuple):
    """Commands for so many periods, before braking."""

    way: int
    periods: int
    linear: float
    angular: float


@compiled
def command_of(backup, k, yaw):
    """Return linear and angular velocity in period k of a back-up, at a yaw."""
    if k >= backup.periods or backup.way == BRAKE:
        return 0.0, 0.0
    if backup.way == ALONG:
        return backup.linear, -STEERING * (yaw - math.pi * round(yaw / math.pi))
    return backup.linear, backup.angular


@compiled
def move(rover, state, rims, substeps):
    """Move a rover whose left and right wheels are to have the speeds `rims` (2,), m/s."""
    h = rover.period / SUBSTEPS
    for _ in range(substeps):
        cos, sin = math.cos(state[2]), math.sin(state[2])
        ahead, sideways = state[3] * cos + state[4] * sin, state[4] * cos - state[3] * sin
        push_ahead, push_left, turn = 0.0, 0.0, 0.0
        for i in range(4):
            x, y = rover.wheels[i]
            slip_x, slip_y = ahead - state[5] * y - state[6 + i], sideways + state[5] * x
            size = max(math.hypot(slip_x, slip_y), rover.slip)
            fx, fy = -slip_x / size, -slip_y / size
            push_ahead, push_left, turn = push_ahead + fx / 4, push_left + fy / 4, turn + (x * fy - y * fx) / 4
            change, dragged = rims[i % 2] - state[6 + i], -rover.rim_friction * fx
            state[6 + i] += min(
                max(change, (dragged - rover.rim_acceleration) * h), (dragged + rover.rim_acceleration) * h
            )
        state[3] += h * rover.grip * (push_ahead * cos - push_left * sin)
        state[4] += h * rover.grip * (push_ahead * sin + push_left * cos)
        state[5] += h * rover.grip * turn / rover.inertia
        state[2] += h * state[5]
        state[0] += h * state[3]
        state[1] += h * state[4]


@compiled
def rims_of(rover, linear, angular, rims):
    """Compute the speeds (2,) of left and right wheels' rims for a command, within limits."""
    linear = min(max(linear, -rover.max_velocity[0]), rover.max_velocity[0])
    angular = min(max(angular, -rover.max_velocity[1]), rover.max_velocity[1])
    rims[0], rims[1] = linear - rover.half_track * angular, linear + rover.half_track * angular
    excess = max(1.0, max(abs(rims[0]), abs(rims[1])) / rover.max_rim_speed)
    rims[0], rims[1] = rims[0] / excess, rims[1] / excess


@compiled
def after_period(rover, states, commands):
    """Move rovers at `states` (n, 10) by a period under `commands` (n, 2)."""
    rims = np.empty(2)
    for row in range(len(states)):
        rims_of(rover, commands[row, 0], commands[row, 1], rims)
        move(rover, states[row], rims, SUBSTEPS)


@compiled
def clearance(rover, world, state, row):
    """Return the distance (m) of a rover from sides, ends and blocks; 0 or below in contact. `row` (10,) is memory."""
    x, y = state[0], state[1]
    cos, sin, nearest = math.cos(state[2]), math.sin(state[2]), np.inf
    for half_x, half_y in rover.outline:
        wide, long = half_x * abs(sin) + half_y * abs(cos), half_x * abs(cos) + half_y * abs(sin)
        nearest = min(nearest, world.half_width - abs(y) - wide, x - long, world.length - x - long)
        for b in range(len(world.blocks)):
            block = world.blocks[b]
            reach = math.hypot(block[8], block[9]) + math.hypot(half_x, half_y)
            if math.hypot(block[4] - x, block[5] - y) - reach > nearest:
                continue
            for k in range(4):
                first_x, first_y = (half_x if k < 2 else -half_x), (half_y if k in (0, 3) else -half_y)
                next_x, next_y = (half_x if k in (0, 3) else -half_x), (half_y if k > 1 else -half_y)
                nearest = min(nearest, segment_to_block(
                    x + first_x * cos - first_y * sin, y + first_x * sin + first_y * cos,
                    x + next_x * cos - next_y * sin, y + next_x * sin + next_y * cos, block,
                ))  # fmt: skip
    return nearest


@compiled
def people_clearance(rover, state, segments, radius, row):
    """Return the distance (m) of a rover from discs that are anywhere on `segments` (w, 4); `row` (10,) is memory."""
    nearest = np.inf
    row[4], row[5], row[6], row[7] = state[0], state[1], math.cos(state[2]), math.sin(state[2])
    for half_x, half_y in rover.outline:
        row[8], row[9] = half_x, half_y
        for w in range(len(segments)):
            ax, ay, bx, by = segments[w]
            nearest = min(nearest, segment_to_block(ax, ay, bx, by, row) - radius)
    return nearest


@compiled
def people_now(world, tick, points):
    """Compute segments (w, 4) without length: where people are at a tick."""
    for w in range(len(points)):
        for axis in range(2):
            points[w, axis] = points[w, 2 + axis] = world.people[tick, w, axis]


@compiled
def stands(rover, state):
    """Return True if a rover stands."""
    speed = math.hypot(state[3], state[4]) + 0.3 * abs(state[5])
    for i in range(4):
        speed = max(speed, abs(state[6 + i]))
    return speed < STANDING


@compiled
def period_under(rover, world, state, command, k, memory):
    """Move a rover by period k under a command (2,); return how far it keeps clear meanwhile, -inf if too little: m."""
    rims, row, points = memory
    nearest = ENOUGH
    rims_of(rover, command[0], command[1], rims)
    for part in range(SUBSTEPS // CHECKED):
        move(rover, state, rims, CHECKED)
        still = clearance(rover, world, state, row)
        if still < world.margin:
            return -np.inf
        tick = k * (SUBSTEPS // CHECKED) + part + 1
        people_now(world, tick, points)
        apart = people_clearance(rover, state, points, world.radius, row)
        if apart < world.people_margin + world.drift * tick * rover.period * CHECKED / SUBSTEPS:
            return -np.inf
        nearest = min(nearest, still, apart)
    return nearest


@compiled
def worth(rover, world, state, nearest, backup, best, memory):
    """Return how far a rover keeps clear in a back-up, from a state after a period in which it did by `nearest` m.

    That is the least clearance, and the one where it stands at last, where nobody walks by: m, each up to `ENOUGH`. It
    is -inf if that is unsafe, or cannot be better than the `best` by `BETTER`.
    """
    row = memory[1]
    for k in range(1, 1 + backup.periods + MAX_PERIODS):
        nearest = min(nearest, period_under(rover, world, state, command_of(backup, k - 1, state[2]), k, memory))
        if nearest + ENOUGH <= best + BETTER:
            return -np.inf
        if k > backup.periods and stands(rover, state):
            apart = people_clearance(rover, state, world.lanes, world.radius, row)
            at_last = min(clearance(rover, world, state, row), apart, ENOUGH)
            return nearest + at_last if apart >= world.people_margin else -np.inf
    return -np.inf


@compiled
def choose(rover, world, state, actions, backups, first, is_first):
    """Return the first of `actions` (n, 2) after which there is a safe back-up, or that of most worth, and the back-up.

    -1: there is none. Those of `backups` that hold a command hold the action; number `first` of them is tried first.
    """
    ways, periods, speeds = backups
    memory = np.empty(2), np.empty(10), np.empty((len(world.lanes), 4))
    best, chosen, follows, second, end = -np.inf, -1, -1, np.empty(10), np.empty(10)
    for a in range(len(actions)):
        command = actions[a, 0], actions[a, 1]
        copy_to(state, second)
        nearest = period_under(rover, world, second, command, 0, memory)
        if nearest + ENOUGH <= best + BETTER:
            continue
        for number in range(len(ways)):
            b = (first + number) % len(ways)
            backup = Backup(ways[b], periods[b], command[0] if ways[b] == HOLD else speeds[b], command[1])
            copy_to(second, end)
            value = worth(rover, world, end, nearest, backup, best, memory)
            if value > best:
                best, chosen, follows = value, a, b
                if is_first:
                    return chosen, follows
    return chosen, follows
