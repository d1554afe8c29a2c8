"""Checks of the configurations that a closed form gives for a pose: see `armctl.kinematics.ik`."""

import math

import numpy as np

from armctl.kernels.arm import linearise, turned, workspace
from armctl.kernels.arm_dynamics import factor, solve
from armctl.kernels.arm_lanes import FRAMES, LANES, pose_errors, tip_frames, twist_length
from armctl.kernels.compiling import compiled, copy_to
from armctl.kernels.reach import nearest_turn

NEAR_ENOUGH, MAX_STEPS = 1e-10, 5
"""m and rad: error of a configuration that is improved no more, and the number of steps after which it is given up."""
NOT_ENOUGH = -1
"""Number of solutions where candidates have to be improved numerically."""
DAMPING = 1e-12
"""Damping of steps (m^2, rad^2): small enough to change none but those at singular poses."""


@compiled
def is_rigid(pose, tolerance):
    """Return True if a matrix (4, 4) is a proper rotation and a translation."""
    for i in range(4):
        for j in range(4):
            if not math.isfinite(pose[i, j]):
                return False
    if pose[3, 0] != 0 or pose[3, 1] != 0 or pose[3, 2] != 0 or pose[3, 3] != 1:
        return False
    for i in range(3):
        for j in range(3):
            product = pose[i, 0] * pose[j, 0] + pose[i, 1] * pose[j, 1] + pose[i, 2] * pose[j, 2]
            if abs(product - (i == j)) >= tolerance:
                return False
    third = pose[0, 0] * pose[1, 1] - pose[0, 1] * pose[1, 0]
    return (
        third * pose[2, 2]
        + (pose[0, 1] * pose[1, 2] - pose[0, 2] * pose[1, 1]) * pose[2, 0]
        + (pose[0, 2] * pose[1, 0] - pose[0, 0] * pose[1, 2]) * pose[2, 1]
        > 0
    )


@compiled
def small_twist(joints, memory, pose, error):
    """Compute the twist (6,) m and rad, in the base, from a near end-effector to a pose; return its length.

    `memory` is that of `linearise`, which has been there.
    """
    last, axis = joints[len(joints) - 1], np.empty(3)
    rotation, tip = memory[0][len(joints) - 1], memory[3]
    error[:] = 0.0
    for column in range(3):
        turned(rotation, last.tip_rotation[:, column], axis)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            error[3 + i] += (axis[j] * pose[k, column] - axis[k] * pose[j, column]) / 2
    square = 0.0
    for i in range(3):
        error[i] = pose[i, 3] - tip[i]
        square += error[i] * error[i] + error[3 + i] * error[3 + i]
    return math.sqrt(square)


@compiled
def tip_jacobian(joints, memory, jacobian):
    """Compute how the motors move the end-effector, (6, dof) in the base, from the `memory` of `linearise`."""
    axes, gradients = memory[2], memory[4]
    jacobian[:] = 0.0
    for i in range(3):
        for k in range(len(gradients)):
            jacobian[i, k] = gradients[k, i]
        for k in range(len(joints)):
            if not joints[k].slides:
                jacobian[3 + i, joints[k].motor] += joints[k].ratio * axes[k, i]


@compiled
def refine(joints, pose, q):
    """Make Newton steps of least length from q (n, dof), in place, to a `pose` (4, 4) that they miss by little."""
    memory, jacobian = workspace(joints), np.empty((6, q.shape[1]))
    gram, error = np.empty((6, 6)), np.empty(6)
    for row in range(len(q)):
        for _ in range(MAX_STEPS):
            linearise(joints, q[row], memory)
            if small_twist(joints, memory, pose, error) < NEAR_ENOUGH:
                break
            tip_jacobian(joints, memory, jacobian)
            for i in range(6):
                for j in range(i + 1):
                    gram[i, j] = DAMPING * (i == j)
                    for k in range(q.shape[1]):
                        gram[i, j] += jacobian[i, k] * jacobian[j, k]
            factor(gram)
            solve(gram, error)
            for k in range(q.shape[1]):
                for i in range(6):
                    q[row, k] += jacobian[i, k] * error[i]


@compiled
def is_distinct(q, solutions, count, distinct):
    """Return True if q (dof,) differs from each of the first solutions by more than `distinct` (rad) in some joint."""
    for other in range(count):
        is_same = True
        for i in range(len(q)):
            is_same = is_same and abs(q[i] - solutions[other, i]) <= distinct
        if is_same:
            return False
    return True


@compiled
def pose_residuals(joints, pose, seed, candidates, residuals):
    """Compute the twists' lengths (1 + k,) to a pose (4, 4), m and rad, at `seed` (dof,) and `candidates` (k, dof)."""
    lanes, q = np.empty(1, FRAMES), np.empty((len(seed), LANES))
    for first in range(0, len(residuals), LANES):
        count = min(LANES, len(residuals) - first)
        for i in range(len(seed)):
            for lane in range(LANES):
                row = first + min(lane, count - 1)
                q[i, lane] = candidates[row - 1, i] if row else seed[i]
        tip_frames(joints, q, lanes[0])
        pose_errors(lanes[0], pose)
        for lane in range(count):
            residuals[first + lane] = twist_length(lanes[0], lane)


@compiled
def choose(joints, pose, candidates, approximate, seed, tolerances, solutions, residuals):
    """Choose the `candidates` (k, dof) for a `pose` (4, 4) that are within the limits, the nearest to `seed` first.

    They are written to `solutions` (k, dof), with their `residuals` (k,); if none is, the nearest outside. Return their
    number, or `NOT_ENOUGH`: all are approximations, the residual of one that is not is above `exact`, or that of `seed`
    (dof,) below `near`. Solutions nearer to each other than `distinct` count once. `tolerances` are these three.
    """
    exact, near, distinct = tolerances
    all_residuals, distances, q = np.empty(1 + len(candidates)), np.empty(1 + len(candidates)), np.empty(len(seed))
    pose_residuals(joints, pose, seed, candidates, all_residuals)
    if all_residuals[0] < near:
        return NOT_ENOUGH
    count, distances[0] = 0, np.inf
    for row in range(len(candidates)):
        if approximate[row]:
            continue
        if not all_residuals[1 + row] < exact:
            return NOT_ENOUGH
        nearest_turn(joints, candidates[row], seed, q)
        is_within, distance, at = True, 0.0, count
        for i in range(len(q)):
            is_within = is_within and joints[i].lower <= q[i] <= joints[i].upper
            distance = max(distance, abs(q[i] - seed[i]))
        if is_within:
            if not is_distinct(q, solutions, count, distinct):
                continue
        elif count > 0 or distance >= distances[0]:
            continue
        while at > 0 and distances[at - 1] > distance:
            distances[at], residuals[at] = distances[at - 1], residuals[at - 1]
            copy_to(solutions[at - 1], solutions[at])
            at -= 1
        distances[at], residuals[at] = distance, all_residuals[1 + row]
        copy_to(q, solutions[at])
        count += is_within
    return count if distances[0] < np.inf else NOT_ENOUGH
