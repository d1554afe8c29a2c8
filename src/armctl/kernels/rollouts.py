"""Costs of sampled action sequences on models of the arm and the rover: see `armctl.control.sampling_rollouts`."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.arm import forward, tip_of
from armctl.kernels.capsules import place
from armctl.kernels.compiling import compiled, copy_to, inlined
from armctl.kernels.drives import follow_all
from armctl.kernels.edges import NEAR_START, Scene, cruise_time, measure_all
from armctl.kernels.imagined_arm import ARRIVED, MOVING, TOUCHED, keeps_margins, use_up
from armctl.kernels.planar import towards

CHECKED_TICKS = 2
"""Ticks of the drives between two places of an arm at which distances are measured."""


class ReachScene(NamedTuple):
    """An arm among boxes, its task, and the prices of a rollout."""

    scene: Scene
    motion: Array
    """(pairs, dof) m/rad: bound on how far each joint moves a pair."""
    margin: float
    """m that pairs keep, or half of their distance at the start if that is less."""
    targets: Array
    """(horizon, 3) m."""
    radius: float
    """m: within it, the target is reached."""
    stays: bool
    """True if the target has to be held, and not only reached."""
    distance: float
    """Price of a metre from the target in a period, 1/m; a period outside the radius costs 1."""
    final: float
    """Price of a metre at the end, 1/m."""
    way: Array
    """(k, dof) rad: configurations to pass; if there are any, the periods along them count instead of that metre."""
    rest: Array
    """(k,) periods from each of them to the last one."""
    passing: float
    """rad: largest joint error at which one is passed."""
    period: float
    """s."""
    touch: float
    """Price of a contact."""
    ticks: int
    """Ticks of the drives per period."""
    tick: float
    """s."""


class Memory(NamedTuple):
    """Memory of a rollout: the arm's state, and what is computed of it."""

    q: Array
    speed: Array
    moved: Array
    """(dof,) rad since distances were measured."""
    margins: Array
    """(pairs,) m that pairs keep."""
    slack: Array
    """(pairs,) m by which a pair exceeds its margin at least."""
    rotations: Array
    origins: Array
    ends: Array
    tip: Array


@compiled
def is_near(first, second, distance):
    """Return True if no joint of two configurations (dof,) differs by more than `distance` (rad)."""
    for i in range(len(first)):  # noqa: SIM110 (generators cannot be compiled)
        if abs(first[i] - second[i]) > distance:
            return False
    return True


@inlined
def move(arm, goal, target, memory):
    """Move an arm for a period towards a goal (dof,); return what comes of it, and its distance (m) from the target."""
    q, speed, moved, margins, slack, rotations, origins, ends, tip = memory
    joints, links, _, _ = arm.scene
    distance = 0.0
    for tick in range(1, arm.ticks + 1):
        follow_all(joints, goal, q, speed, 1, arm.tick)
        for i in range(len(speed)):
            moved[i] += abs(speed[i] * arm.tick)
        if tick % CHECKED_TICKS and tick < arm.ticks:
            continue
        is_used_up = use_up(arm.motion, slack, moved)
        moved[:] = 0.0
        if arm.stays and not is_used_up and tick < arm.ticks:
            continue
        forward(joints, q, rotations, origins)
        tip_of(joints, rotations, origins, tip)
        distance = math.sqrt((tip[0] - target[0]) ** 2 + (tip[1] - target[1]) ** 2 + (tip[2] - target[2]) ** 2)
        if is_used_up:
            place(links, rotations, origins, ends)
            if not keeps_margins(arm.scene, margins, slack, ends):
                return TOUCHED, distance
        if not arm.stays and distance <= arm.radius:
            return ARRIVED, 0.0
    return MOVING, distance


@compiled
def reach_cost(arm, goals, memory):
    """Return the cost of goals (horizon, dof)."""
    cost, distance, passed, last = 0.0, 0.0, 0, len(arm.way) - 1
    for k in range(len(goals)):
        state, distance = move(arm, goals[k], arm.targets[k], memory)
        if state == TOUCHED:
            return cost + arm.touch + len(goals) - k + arm.final * distance
        if state == ARRIVED:
            return cost
        cost += (distance > arm.radius) + arm.distance * distance
        if passed < last and is_near(memory.q, arm.way[passed], arm.passing):
            passed += 1
    if last < 0:
        return cost + arm.final * distance
    return cost + arm.rest[passed] + cruise_time(arm.scene.joints, memory.q, arm.way[passed]) / arm.period


@compiled
def reach(arm, position, velocity, candidates, costs):
    """Compute the `costs` (n,) of drives that go from `position` with `velocity` (dof,) to goals `candidates`.

    These are (n, horizon, dof): joint positions in each period. A contact ends a rollout, and costs all periods that
    remain; so does an arrival at a target that need not be held, for which they cost nothing.
    """
    dof, frames, num_pairs = len(position), len(arm.scene.joints), len(arm.scene.pairs)
    memory = Memory(
        np.empty(dof), np.empty(dof), np.zeros(dof), np.empty(num_pairs), np.empty(num_pairs),
        np.empty((frames, 3, 3)), np.empty((frames, 3)), np.empty((len(arm.scene.links), 2, 3)), np.empty(3),
    )  # fmt: skip
    slack_at_start = np.empty(num_pairs)
    measure_all(arm.scene, position, slack_at_start)
    for i in range(num_pairs):
        memory.margins[i] = min(arm.margin, NEAR_START * max(slack_at_start[i], 0.0))
        slack_at_start[i] -= memory.margins[i]
    for c in range(len(candidates)):
        copy_to(position, memory.q)
        copy_to(velocity, memory.speed)
        copy_to(slack_at_start, memory.slack)
        memory.moved[:] = 0.0
        costs[c] = reach_cost(arm, candidates[c], memory)


class DriveScene(NamedTuple):
    """A rover on a bridge, and the prices of a rollout."""

    max_velocity: Array
    """(2,) m/s and rad/s."""
    max_change: Array
    """(2,) m/s and rad/s per period."""
    max_rim_speed: float
    """m/s."""
    half_track: float
    """m, with skidding: rim speed = linear -+ this x angular velocity."""
    period: float
    """s."""
    blocks: NDArray[np.float64]
    """Blocks, as in `armctl.kernels.bridge`."""
    half_width: float
    """m."""
    lengths: Array
    """(nx, ny) m to go from points of a lattice over the deck."""
    spacings: Array
    """(2,) m between these points."""
    clearance: float
    """m: distance of the rover's middle from blocks and sides."""
    people: Array
    """(horizon + 1, w, 2) m."""
    distance: float
    """m: distance of the rover's middle from people's."""
    intrusion: float
    """Price of a metre within these distances in a period, 1/m."""
    turn_rate: float
    """Price of the squared turn rate in a period, s^2."""
    final: float
    """Price of a metre to go at the end, 1/m; it costs 1 in each period."""


@compiled
def length_to_go(lengths, spacings, half_width, x, y):
    """Return the length (m) to go from a place, bilinear between the points of a lattice."""
    nx, ny = lengths.shape
    at_x = min(max(x / spacings[0], 0.0), nx - 1.0)
    at_y = min(max((y + half_width) / spacings[1], 0.0), ny - 1.0)
    i, j = min(int(at_x), nx - 2), min(int(at_y), ny - 2)
    u, v = at_x - i, at_y - j
    right = (1 - u) * lengths[i, j] + u * lengths[i + 1, j]
    return (1 - v) * right + v * ((1 - u) * lengths[i, j + 1] + u * lengths[i + 1, j + 1])


@compiled
def room_at(drive, k, x, y):
    """Return the distance (m) that a rover has to spare in period k, at most 0."""
    room = min(drive.half_width - abs(y) - drive.clearance, 0.0)
    for b in range(len(drive.blocks)):
        block = drive.blocks[b]
        cos, sin, dx, dy = block[6], block[7], x - block[4], y - block[5]
        beyond_x, beyond_y = abs(dx * cos + dy * sin) - block[8], abs(dy * cos - dx * sin) - block[9]
        if beyond_x < drive.clearance and beyond_y < drive.clearance:
            outside = math.hypot(max(beyond_x, 0.0), max(beyond_y, 0.0)) + min(max(beyond_x, beyond_y), 0.0)
            room = min(room, outside - drive.clearance)
    for w in range(drive.people.shape[1]):
        apart = math.hypot(drive.people[k, w, 0] - x, drive.people[k, w, 1] - y)
        room = min(room, apart - drive.distance)
    return room


@compiled
def cross(drive, start, candidates, costs):
    """Compute the `costs` (n,) of a rover from x, y, yaw, linear and angular velocity (5,), for commands `candidates`.

    These are (n, horizon, 2): linear and angular velocities. The rover's own approach them by at most `max_change`.
    """
    top, change, period = drive.max_velocity, drive.max_change, drive.period
    for c in range(len(candidates)):
        x, y, yaw, linear, angular = start[0], start[1], start[2], start[3], start[4]
        cost, to_go = 0.0, 0.0
        for k in range(candidates.shape[1]):
            goal, turn = candidates[c, k, 0], candidates[c, k, 1]
            goal, turn = min(max(goal, -top[0]), top[0]), min(max(turn, -top[1]), top[1])
            excess = max(1.0, (abs(goal) + drive.half_track * abs(turn)) / drive.max_rim_speed)
            next_linear = towards(linear, goal / excess, change[0])
            next_angular = towards(angular, turn / excess, change[1])
            distance, turned = period * (linear + next_linear) / 2, period * (angular + next_angular) / 2
            x += distance * math.cos(yaw + turned / 2)
            y += distance * math.sin(yaw + turned / 2)
            yaw += turned
            linear, angular = next_linear, next_angular
            to_go = length_to_go(drive.lengths, drive.spacings, drive.half_width, x, y)
            cost += to_go + drive.turn_rate * angular * angular - drive.intrusion * room_at(drive, k + 1, x, y)
            if to_go <= 0.0:
                break
        costs[c] = cost + drive.final * to_go
