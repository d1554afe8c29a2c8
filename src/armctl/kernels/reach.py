"""Moving an arm's end-effector into a sphere in minimum time: see `armctl.kinematics.minimum_time_reach`."""

import math
from typing import NamedTuple

import numpy as np

from armctl.core.arrays import Array
from armctl.kernels.arm import cross, linearise, tips, turned, workspace
from armctl.kernels.compiling import compiled, copy_to
from armctl.kernels.drives import min_time

MAX_APPROACH_STEP = 0.5
"""rad: joint step limit in one iteration of `approach`."""
INSIDE = 5e-5
"""m: depth inside the sphere that is aimed at, since linear programs end beside a curved surface."""
MIN_SLOPE = 0.05
"""m/s: lower bound on the approach speed when the time is estimated from it."""
MAX_TIME_CHANGE = 0.1
"""s: limit on one change of the time estimate."""
NO_GAIN = 1e-9
"""m/rad: a joint that brings the end-effector nearer by less only turns it on the spot, and goes back to its start."""
AIM = 0.9
"""Fraction of the radius: a straight move aims at the sphere's nearest point at this distance from its centre."""
BESIDE = 0.01
"""Share of the way to its start by which a configuration is moved off a pose: there, all directions lead away."""
TIP_SPEED = 1.0
"""m/s: speed at which the end-effector is assumed to cover the remaining distance to a sphere."""


class Start(NamedTuple):
    """State in which an arm sets off."""

    position: Array
    """(dof,) rad."""
    velocity: Array
    """(dof,) rad/s."""


class Spheres(NamedTuple):
    """m target spheres, each with configurations that have the end-effector in it."""

    centres: Array
    """(m, 3) m."""
    goals: Array
    """(m, goals, dof) rad."""
    excess: Array
    """(m, goals) s: added time for goals whose end-effector is still outside."""


@compiled
def damped_step(gradients, error, damping, step):
    """Step (dof,) that moves a point by about `error` (3,): J^T (J J^T + damping I)^-1 error.

    `gradients` (dof, 3) are the rows of J^T. The matrix is positive definite, and solved by Cholesky's factors.
    """
    a00 = a11 = a22 = damping
    a10 = a20 = a21 = 0.0
    for k in range(len(gradients)):
        x, y, z = gradients[k]
        a00 += x * x
        a11 += y * y
        a22 += z * z
        a10 += x * y
        a20 += x * z
        a21 += y * z
    l00 = math.sqrt(a00)
    l10, l20 = a10 / l00, a20 / l00
    l11 = math.sqrt(a11 - l10 * l10)
    l21 = (a21 - l20 * l10) / l11
    l22 = math.sqrt(a22 - l20 * l20 - l21 * l21)
    x = error[0] / l00
    y = (error[1] - l10 * x) / l11
    z = (error[2] - l20 * x - l21 * y) / l22
    z /= l22
    y = (y - l21 * z) / l11
    x = (x - l10 * y - l20 * z) / l00
    for k in range(len(gradients)):
        step[k] = gradients[k, 0] * x + gradients[k, 1] * y + gradients[k, 2] * z


@compiled
def approach(joints, q, centres, iterations):
    """Make Levenberg-Marquardt iterations from q (n, dof), in place, to end-effector positions `centres` (n, 3), m."""
    dof = q.shape[1]
    memory, error, step = workspace(joints), np.empty(3), np.empty(dof)
    for row in range(len(q)):
        for _ in range(iterations):
            tip, gradients = linearise(joints, q[row], memory)
            square = 0.0
            for i in range(3):
                error[i] = centres[row, i] - tip[i]
                square += error[i] * error[i]
            damped_step(gradients, error, 0.5 * square + 1e-6, step)
            largest = 0.0
            for k in range(dof):
                largest = max(largest, abs(step[k]))
            share = min(1.0, MAX_APPROACH_STEP / (largest + 1e-12))
            for k in range(dof):
                q[row, k] += share * step[k]


@compiled
def approach_rates(joints, q, centre, memory, rates):
    """Compute how fast each motor brings the end-effector nearer to `centre`, (dof,) m/rad; return the distance, m.

    A centre is a position (3,), or a pose (12,): the position, and the three axes, scaled. So are distances.
    """
    tip, gradients = linearise(joints, q, memory)
    x, y, z = centre[0] - tip[0], centre[1] - tip[1], centre[2] - tip[2]
    square = x * x + y * y + z * z
    twist = np.zeros(3)
    if len(centre) > 3:
        square += missing_turn(joints, memory[0], centre, twist)
    distance = math.sqrt(square) + 1e-12
    for k in range(len(rates)):
        rates[k] = (gradients[k, 0] * x + gradients[k, 1] * y + gradients[k, 2] * z) / distance
    if len(centre) > 3:
        axes = memory[2]
        for k in range(len(joints)):
            if not joints[k].slides:
                turn = axes[k, 0] * twist[0] + axes[k, 1] * twist[1] + axes[k, 2] * twist[2]
                rates[joints[k].motor] += joints[k].ratio * turn / distance
    return distance


@compiled
def missing_turn(joints, rotations, centre, twist):
    """Return the squared distance of the end-effector's scaled axes from those of a pose `centre` (12,), m^2.

    `twist` (3,) becomes half its descent by rotations about the base's axes, m^2/rad.
    """
    last, square = len(joints) - 1, 0.0
    axis, target_axis, product = np.empty(3), np.empty(3), np.empty(3)
    scale = math.sqrt(centre[3] ** 2 + centre[4] ** 2 + centre[5] ** 2)
    for column in range(3):
        turned(rotations[last], joints[last].tip_rotation[:, column], axis)
        for i in range(3):
            axis[i] *= scale
            target_axis[i] = centre[3 + 3 * column + i]
            square += (target_axis[i] - axis[i]) ** 2
        cross(axis, target_axis, product)
        for i in range(3):
            twist[i] += product[i]
    return square


@compiled
def step_into_sphere(joints, q, start, centre, radius, max_step, memory, step):
    """Solve one linear program at q (dof,): the step (dof,) into the sphere that takes the least time.

    Returns the time (s) from `start` to q, and the distance (m) at q from the sphere's centre. Newton's method improves
    the time. Two of its steps are enough: programs solved to convergence overshoot, since they are valid only nearby.
    """
    dof = len(q)
    position, velocity = start
    gain = np.empty(dof)
    distance = approach_rates(joints, q, centre, memory, gain)
    arrival = min_time(joints, position, velocity, q)
    needed, time = distance - radius + INSIDE, arrival
    for _ in range(2):
        missing, slope = needed, 0.0
        for k in range(dof):
            if abs(gain[k]) < NO_GAIN:
                step[k] = min(max(position[k] - q[k], -max_step), max_step)
                continue
            joint, sign = joints[k], 1.0 if gain[k] > 0 else -1.0
            ahead = sign * velocity[k]
            ramp = min(time, (joint.top - ahead) / joint.acceleration)
            speed = ahead + joint.acceleration * ramp
            reach = (ahead + speed) / 2 * ramp + joint.top * (time - ramp)
            room = joint.upper - q[k] if gain[k] > 0 else q[k] - joint.lower
            length = min(min(reach - sign * (q[k] - position[k]), room), max_step)
            missing -= abs(gain[k]) * length
            if length < max_step:
                slope += abs(gain[k]) * speed
            step[k] = sign * min(max(length, -max_step), max_step)
        change = missing / max(slope, MIN_SLOPE)
        time = max(time + min(max(change, -MAX_TIME_CHANGE), MAX_TIME_CHANGE), 1e-3)
    return arrival, distance


@compiled
def refine(joints, q, starts, centres, radius, velocities, max_steps, times):
    """Improve q (n, dof) by linear programs with joint steps up to `max_steps` (m,) rad, each in its sphere.

    In place, q becomes the best that was met in the sphere, and `times` (n,) when it is reached: infinite if none was.
    Its sphere is around `centres`, (n, 3) or (n, 12): see `approach_rates`. Arms move from `starts` with `velocities`,
    (n, dof) each.
    """
    dof = q.shape[1]
    memory, step, at = workspace(joints), np.empty(dof), np.empty(dof)
    for row in range(len(q)):
        times[row] = np.inf
        for k in range(dof):
            at[k] = min(max(q[row, k], joints[k].lower), joints[k].upper)
        for max_step in max_steps:
            start = Start(starts[row], velocities[row])
            time, distance = step_into_sphere(joints, at, start, centres[row], radius, max_step, memory, step)
            if distance <= radius and time < times[row]:
                times[row] = time
                copy_to(at, q[row])
            for k in range(dof):
                at[k] += step[k]


@compiled
def nearest_turn(joints, q, seed, out):
    """Shift each joint of q (dof,) by whole turns to be near `seed` (dof,), as far as its limits allow."""
    turn = 2 * math.pi
    for k in range(len(q)):
        near = q[k] + turn * round((seed[k] - q[k]) / turn)
        out[k] = near + turn * (near < joints[k].lower) - turn * (near > joints[k].upper)


@compiled
def move_to(joints, q, positions, centres, radius, iterations, excess):
    """Move q (n, dof), in place, towards end-effector `positions` (n, 3), m, within the limits.

    `excess` (n,) becomes the time (s) to the sphere around `centres` (n, 3), for tips outside it.
    """
    tip_positions = np.empty((len(q), 3))
    approach(joints, q, positions, iterations)
    for row in range(len(q)):
        for k in range(q.shape[1]):
            q[row, k] = min(max(q[row, k], joints[k].lower), joints[k].upper)
    tips(joints, q, tip_positions)
    for row in range(len(q)):
        excess[row] = remaining_time(distance_between(tip_positions[row], centres[row]), radius)


@compiled
def distance_between(first, second):
    """Return the distance of two points (3,), m."""
    square = 0.0
    for i in range(3):
        square += (first[i] - second[i]) ** 2
    return math.sqrt(square)


@compiled
def remaining_time(distance, radius):
    """Return the time (s) to a sphere from a `distance` (m) from its centre; 0 inside."""
    return max(distance - radius, 0.0) / TIP_SPEED


@compiled
def min_times_into_spheres(joints, q, velocities, spheres, radius, iterations, max_steps, times):
    """Compute the `times` (m,) of `armctl.kinematics.ReachTimes`, s, from q (m, dof) with `velocities` into spheres."""
    dof = q.shape[1]
    centres, goals, excess = spheres
    memory, goal, turned, step = workspace(joints), np.empty((1, dof)), np.empty(dof), np.empty(dof)
    tip, aim, late_by = np.empty((1, 3)), np.empty((1, 3)), np.empty(1)
    for i in range(len(q)):
        centre, start = centres[i], Start(q[i], velocities[i])
        tips(joints, q[i : i + 1], tip)
        distance = distance_between(tip[0], centre)
        if distance <= radius:
            times[i] = 0.0
            continue
        for axis in range(3):
            aim[0, axis] = centre[axis] + (tip[0, axis] - centre[axis]) * (AIM * radius / distance)
        copy_to(q[i], goal[0])
        move_to(joints, goal, aim, centres[i : i + 1], radius, iterations, late_by)
        shortest = min_time(joints, q[i], velocities[i], goal[0]) + late_by[0]
        for g in range(goals.shape[1]):
            nearest_turn(joints, goals[i, g], q[i], turned)
            time = min_time(joints, q[i], velocities[i], turned) + excess[i, g]
            if time <= shortest:
                shortest = time
                copy_to(turned, goal[0])
        for max_step in max_steps:
            time, at = step_into_sphere(joints, goal[0], start, centre, radius, max_step, memory, step)
            shortest = min(shortest, time + remaining_time(at, radius))
            for k in range(dof):
                goal[0, k] += step[k]
        times[i] = shortest


@compiled
def min_times_to_poses(joints, q, velocities, centres, radius, goals, max_steps, times):
    """Compute the `times` (m,) s from q (m, dof) with `velocities` to poses `centres` (m, 12), within `radius` (m).

    Each has configurations `goals` (m, k, dof) rad, the last of which may be missing: NaN.
    """
    dof = q.shape[1]
    memory, goal, turned_goal, step = workspace(joints), np.empty(dof), np.empty(dof), np.empty(dof)
    for i in range(len(q)):
        start = Start(q[i], velocities[i])
        if approach_rates(joints, q[i], centres[i], memory, step) <= radius:
            times[i] = 0.0
            continue
        shortest = np.inf
        for g in range(goals.shape[1]):
            if math.isnan(goals[i, g, 0]):
                break
            nearest_turn(joints, goals[i, g], q[i], turned_goal)
            time = min_time(joints, q[i], velocities[i], turned_goal)
            if time < shortest:
                shortest = time
                for k in range(dof):
                    goal[k] = turned_goal[k] + BESIDE * (q[i, k] - turned_goal[k])
        for max_step in max_steps:
            time, at = step_into_sphere(joints, goal, start, centres[i], radius, max_step, memory, step)
            shortest = min(shortest, time + remaining_time(at, radius))
            for k in range(dof):
                goal[k] += step[k]
        times[i] = shortest
