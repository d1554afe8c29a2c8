"""The arithmetic of `armctl.control.reach_mpc`, for a horizon of N periods: see `armctl.control.reach_problem`."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels.arm import axes_of, cross, forward, gradients_of, tip_of, turned
from armctl.kernels.capsules import place
from armctl.kernels.clearance import measure
from armctl.kernels.compiling import compiled


class Knots(NamedTuple):
    """Kinematics at the knots of a motion."""

    q: Array
    """(N, dof) rad."""
    errors: Array
    """(N, 3) m: of the tips from their targets; (N, 12) with those of the three scaled axes."""
    axes: Array
    """(N, dof, 3): of the joints; zero for what has no second derivatives."""
    gradients: Array
    """(N, dof, 3 or 12) m/rad: derivatives of the errors by each joint."""


class Entries(NamedTuple):
    """Places of the obstacles' constraints in a quadratic program."""

    marked: NDArray[np.int64]
    """Entries of the sparse matrix's data."""
    order: NDArray[np.int64]
    """Numbers of the normals that belong there."""
    begin: int
    """First of the constraints' rows."""


@compiled
def roll_out(period, position, velocities, positions, accelerations):
    """Compute `positions` (N + 1, dof) and `accelerations` (N, dof) of a motion with `velocities` (N + 1, dof)."""
    for i in range(len(position)):
        positions[0, i] = position[i]
        for k in range(len(accelerations)):
            velocity, next_velocity = velocities[k, i], velocities[k + 1, i]
            positions[k + 1, i] = positions[k, i] + (velocity + next_velocity) * (period / 2)
            accelerations[k, i] = (next_velocity - velocity) / period


@compiled
def fastest_to_stop(room, period, acceleration):
    """Return the highest velocity at a period's end from which a joint stops within `room`, with half the period."""
    return acceleration * (math.sqrt(period * period + 2 * max(room, 0.0) / acceleration) - period)


@compiled
def project(joints, period, position, velocity, targets, positions, velocities, accelerations):
    """Compute the motion near velocities `targets` (N + 1, dof) that keeps the limits, if the initial state allows."""
    horizon, leaves = len(accelerations), False
    for i in range(len(position)):
        joint, changed = joints[i], velocity[i]
        change = joint.acceleration * period
        velocities[0, i] = changed
        for k in range(horizon):
            changed += min(max(targets[k + 1, i] - targets[k, i], -change), change)
            velocities[k + 1, i] = min(max(changed, -joint.top), joint.top)
    roll_out(period, position, velocities, positions, accelerations)
    for i in range(len(position)):
        joint, last = joints[i], velocities[horizon, i]
        stop = positions[horizon, i] + last * (abs(last) / (2 * joint.acceleration) + period / 2)
        leaves = leaves or stop < joint.lower or stop > joint.upper
        for k in range(horizon + 1):
            leaves = leaves or positions[k, i] < joint.lower or positions[k, i] > joint.upper
    if leaves:
        for i in range(len(position)):
            joint, at = joints[i], position[i]
            change = joint.acceleration * period
            for k in range(horizon):
                speed = velocities[k, i]
                fastest = fastest_to_stop(joint.upper - at - speed * period / 2, period, joint.acceleration)
                slowest = -fastest_to_stop(at + speed * period / 2 - joint.lower, period, joint.acceleration)
                next_speed = min(max(velocities[k + 1, i], slowest), fastest)
                next_speed = min(max(next_speed, -joint.top), joint.top)
                velocities[k + 1, i] = min(max(next_speed, speed - change), speed + change)
                at += (speed + velocities[k + 1, i]) * period / 2
        roll_out(period, position, velocities, positions, accelerations)


@compiled
def brake(joints, period, velocity, velocities):
    """Compute `velocities` (N + 1, dof) of joints that brake from `velocity` (dof,) until they stop."""
    for k in range(len(velocities)):
        for i in range(len(velocity)):
            speed = max(abs(velocity[i]) - k * joints[i].acceleration * period, 0.0)
            velocities[k, i] = math.copysign(speed, velocity[i])


@compiled
def go_straight(joints, period, position, velocity, goal, velocities):
    """Compute `velocities` (N + 1, dof) of joints that each move to `goal` (dof,) in minimum time, and stop there."""
    for i in range(len(position)):
        joint, at, speed = joints[i], position[i], velocity[i]
        change = joint.acceleration * period
        velocities[0, i] = speed
        for k in range(1, len(velocities)):
            distance = goal[i] - at - speed * period / 2
            fastest = fastest_to_stop(abs(distance), period, joint.acceleration)
            target = math.copysign(min(fastest, joint.top), distance)
            next_speed = min(max(target, speed - change), speed + change)
            at += (speed + next_speed) * period / 2
            speed = next_speed
            velocities[k, i] = speed


@compiled
def cost_of(weights, posture, positions, velocities, accelerations, errors):
    """Return the cost (m^2) of a motion whose tips miss their targets by `errors` (N, 3 or 12).

    `weights` are those of distance from `posture` (dof,), velocity, and acceleration.
    """
    horizon, dof = accelerations.shape
    total = 0.0
    for k in range(horizon):
        square = 0.0
        for axis in range(errors.shape[1]):
            square += errors[k, axis] ** 2
        total += square
        for i in range(dof):
            total += weights[0] * (positions[k + 1, i] - posture[i]) ** 2
            total += weights[1] * velocities[k + 1, i] ** 2 + weights[2] * accelerations[k, i] ** 2
    return total


@compiled
def evaluate_knots(scene, targets, knots, min_distances):
    """Compute errors from `targets` (N, 3 or 12) m, axes and gradients of `knots`, and `min_distances` of pairs (N,) m.

    Targets with 12 numbers are poses: a position, and the three axes, scaled.
    """
    joints, links, pairs, boxes, samples, scales = scene
    q, errors, axes, gradients = knots
    count, dof = len(joints), q.shape[1]
    rotations, origins, tip = np.empty((count, 3, 3)), np.empty((count, 3)), np.empty(3)
    own_axes = np.empty((count, 3))
    ends, distances = np.empty((len(links), 2, 3)), np.empty(len(pairs))
    for k in range(len(q)):
        forward(joints, q[k], rotations, origins)
        tip_of(joints, rotations, origins, tip)
        axes_of(joints, rotations, own_axes)
        gradients_of(joints, own_axes, origins, tip, gradients[k, :, :3])
        if targets.shape[1] > 3:
            turn_axes(joints, rotations, own_axes, targets[k], errors[k], gradients[k])
        for i in range(dof):
            # A joint that slides turns nothing, which its axis stands for in second derivatives; if joints follow
            # others, these are left out: what remains is Gauss and Newton's part.
            curves = count == dof and not joints[i].slides
            for axis in range(3):
                axes[k, i, axis] = own_axes[i, axis] if curves else 0.0
        for i in range(3):
            errors[k, i] = tip[i] - targets[k, i]
        if len(pairs):
            place(links, rotations, origins, ends)
            min_distances[k] = measure(links, pairs, boxes, samples, scales, ends, distances)


@compiled
def turn_axes(joints, rotations, axes, target, errors, gradients):
    """Compute the last 9 `errors` (12,) m, those of the scaled axes, and their `gradients` (dof, 12) m/rad."""
    last, axis, change = len(joints) - 1, np.empty(3), np.empty(3)
    scale = math.sqrt(target[3] ** 2 + target[4] ** 2 + target[5] ** 2)
    gradients[:, 3:] = 0.0
    for column in range(3):
        first = 3 + 3 * column
        turned(rotations[last], joints[last].tip_rotation[:, column], axis)
        for i in range(3):
            axis[i] *= scale
            errors[first + i] = axis[i] - target[first + i]
        for k in range(len(joints)):
            if not joints[k].slides:
                cross(axes[k], axis, change)
                for i in range(3):
                    gradients[joints[k].motor, first + i] += joints[k].ratio * change[i]


@compiled
def squared_error_hessian(gradients, axes, error, exact, hessian):
    """Compute half the `hessian` (dof, dof) of the tip's squared error, or without `exact`, Gauss and Newton's part.

    The second derivative of a point or an axis by joints i <= j is axis_i x (its first by j).
    """
    bent = np.empty(3)
    hessian[:] = 0.0
    for first in range(0, len(error), 3):
        for j in range(len(gradients)):
            gradient = gradients[j, first : first + 3]
            cross(gradient, error[first : first + 3], bent)
            for i in range(j + 1):
                value = hessian[i, j]
                for axis in range(3):
                    value += gradients[i, first + axis] * gradient[axis]
                    if exact:
                        value += axes[i, axis] * bent[axis]
                hessian[i, j] = hessian[j, i] = value


@compiled
def convexify(hessian):
    """Replace a symmetric matrix by its nearest positive semidefinite one: negative eigenvalues become 0."""
    values, vectors = np.linalg.eigh(hessian)
    hessian[:] = 0.0
    for which in range(len(values)):
        if values[which] > 0:
            for i in range(len(values)):
                for j in range(len(values)):
                    hessian[i, j] += values[which] * vectors[i, which] * vectors[j, which]


@compiled
def quadratic_model(knots, exact, weight, posture, hessians, slopes):
    """Compute convex `hessians` (N, dof, dof) and `slopes` (N, dof), at q = 0, of the cost of the knots' places.

    Without `exact`, they are Gauss and Newton's. `weight` is that of the distance from `posture` (dof,).
    """
    q, errors, axes, gradients = knots
    dof = q.shape[1]
    for k in range(len(q)):
        hessian = hessians[k]
        squared_error_hessian(gradients[k], axes[k], errors[k], exact, hessian)
        if exact:
            convexify(hessian)
        for i in range(dof):
            slope = -2 * weight * posture[i]
            for axis in range(errors.shape[1]):
                slope += 2 * gradients[k, i, axis] * errors[k, axis]
            for j in range(dof):
                hessian[i, j] *= 2
                slope -= hessian[i, j] * q[k, j]
            slopes[k, i] = slope
            hessian[i, i] += 2 * weight


@compiled
def write_positions_cost(hessians, slopes, entries, knots, rows, columns, data, gradient):
    """Write the cost of the knots' positions: the `entries` (m,) of a sparse Hessian's `data`, and the `gradient`.

    Entry i is that of `rows[i]` and `columns[i]` of the Hessian of knot `knots[i]`.
    """
    horizon, dof = slopes.shape
    for i in range(len(entries)):
        data[entries[i]] = hessians[knots[i], rows[i], columns[i]]
    for k in range(horizon):
        for i in range(dof):
            gradient[k * dof + i] = slopes[k, i]


@compiled
def write_obstacles(distances, normals, q, margin, scale, entries, data, lower):
    """Write the constraints scale normals q_k >= scale (margin - distances + normals q) of `distances` (N, m) at q.

    `normals` are (N, m, dof), q is (N, dof). `data` is that of the sparse matrix, `lower` are its lower bounds.
    """
    marked, order, begin = entries
    horizon, count = distances.shape
    flat = normals.reshape(-1)
    for i in range(len(marked)):
        data[marked[i]] = scale * flat[order[i]]
    for k in range(horizon):
        for i in range(count):
            bound = margin - distances[k, i]
            for j in range(q.shape[1]):
                bound += normals[k, i, j] * q[k, j]
            lower[begin + k * count + i] = scale * bound
