"""The arithmetic of `armctl.control.reach_mpc`, for a horizon of N periods: see `armctl.control.reach_problem`."""

import math

import numpy as np

from armctl.kernels.arm import axes_of, cross, forward, gradients_of, tip_of
from armctl.kernels.capsules import place
from armctl.kernels.clearance import measure
from armctl.kernels.compiling import compiled


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
    for i in range(len(joints)):
        joint, changed = joints[i], velocity[i]
        change = joint.acceleration * period
        velocities[0, i] = changed
        for k in range(horizon):
            changed += min(max(targets[k + 1, i] - targets[k, i], -change), change)
            velocities[k + 1, i] = min(max(changed, -joint.top), joint.top)
    roll_out(period, position, velocities, positions, accelerations)
    for i in range(len(joints)):
        joint, last = joints[i], velocities[horizon, i]
        stop = positions[horizon, i] + last * (abs(last) / (2 * joint.acceleration) + period / 2)
        leaves = leaves or stop < joint.lower or stop > joint.upper
        for k in range(horizon + 1):
            leaves = leaves or positions[k, i] < joint.lower or positions[k, i] > joint.upper
    if leaves:
        for i in range(len(joints)):
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
        for i in range(len(joints)):
            slower = max(abs(velocity[i]) - k * joints[i].acceleration * period, 0.0)
            velocities[k, i] = math.copysign(slower, velocity[i])


@compiled
def go_straight(joints, period, position, velocity, goal, velocities):
    """Compute `velocities` (N + 1, dof) of joints that each move to `goal` (dof,) in minimum time, and stop there."""
    for i in range(len(joints)):
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
    """Return the cost (m^2) of a motion whose tips miss their targets by `errors` (N, 3).

    `weights` are those of distance from `posture` (dof,), velocity, and acceleration.
    """
    horizon, dof = accelerations.shape
    total = 0.0
    for k in range(horizon):
        total += errors[k, 0] ** 2 + errors[k, 1] ** 2 + errors[k, 2] ** 2
        for i in range(dof):
            total += weights[0] * (positions[k + 1, i] - posture[i]) ** 2
            total += weights[1] * velocities[k + 1, i] ** 2 + weights[2] * accelerations[k, i] ** 2
    return total


@compiled
def evaluate_knots(joints, links, pairs, boxes, samples, scales, q, targets, errors, axes, gradients, min_distances):
    """Compute the kinematics at the knots q (N, dof).

    These are the `errors` of the tips from their `targets`, (N, 3) m; the joints' `axes` and the tips' `gradients`,
    (N, dof, 3); and the `min_distances` of the pairs, (N,) m.
    """
    dof = len(joints)
    rotations, origins, tip = np.empty((dof, 3, 3)), np.empty((dof, 3)), np.empty(3)
    ends, distances = np.empty((len(links), 2, 3)), np.empty(len(pairs))
    for k in range(len(q)):
        forward(joints, q[k], rotations, origins)
        tip_of(joints, rotations, origins, tip)
        axes_of(joints, rotations, axes[k])
        gradients_of(axes[k], origins, tip, gradients[k])
        for i in range(3):
            errors[k, i] = tip[i] - targets[k, i]
        if len(pairs):
            place(links, rotations, origins, ends)
            min_distances[k] = measure(links, pairs, boxes, samples, scales, ends, distances)


@compiled
def quadratic_model(q, errors, axes, gradients, exact, weight, posture, hessians, slopes):
    """Compute convex `hessians` (N, dof, dof) and `slopes` (N, dof), at q = 0, of the cost of the knots q (N, dof).

    Without `exact`, they are Gauss and Newton's. The tip's second derivative by joints i <= j is
    axis_i x (its first by j). `weight` is that of the distance from `posture` (dof,).
    """
    dof = q.shape[1]
    bent = np.empty(3)
    for k in range(len(q)):
        hessian = hessians[k]
        for j in range(dof):
            gradient = gradients[k, j]
            cross(gradient, errors[k], bent)
            for i in range(j + 1):
                value = 0.0
                for axis in range(3):
                    value += gradients[k, i, axis] * gradient[axis]
                    if exact:
                        value += axes[k, i, axis] * bent[axis]
                hessian[i, j] = hessian[j, i] = value
        if exact:
            values, vectors = np.linalg.eigh(hessian)
            hessian[:] = 0.0
            for which in range(dof):
                if values[which] > 0:
                    for i in range(dof):
                        for j in range(dof):
                            hessian[i, j] += values[which] * vectors[i, which] * vectors[j, which]
        for i in range(dof):
            slope = -2 * weight * posture[i]
            for axis in range(3):
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
def write_obstacles(distances, normals, q, margin, scale, marked, order, data, lower, begin):
    """Write the constraints scale normals q_k >= scale (margin - distances + normals q) of `distances` (N, m) at q.

    `normals` are (N, m, dof), q is (N, dof). Entry `marked[i]` of a sparse matrix's `data` is the normals' `order[i]`,
    and the bounds `lower` begin at `begin`.
    """
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
