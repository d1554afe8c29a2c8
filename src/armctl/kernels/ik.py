"""Checks of the configurations that a closed form gives for a pose: see `armctl.kinematics.ik`."""

import math

import numpy as np

from armctl.kernels.arm import forward, linearise, tip_of, turned, workspace
from armctl.kernels.arm_dynamics import factor, solve
from armctl.kernels.compiling import compiled, copy_to, inlined
from armctl.kernels.reach import nearest_turn

NEAR_ENOUGH, MAX_STEPS = 1e-10, 5
"""m and rad: error of a configuration that is improved no more, and the number of steps after which it is given up."""
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


@inlined
def dot(rotation, i, x, y, z):
    """Return the product of column i of a rotation (3, 3) and a vector."""
    return rotation[0, i] * x + rotation[1, i] * y + rotation[2, i] * z


@inlined
def relative(rotation, pose, i, j):
    """Return an entry of the rotation from a frame to a pose (4, 4)."""
    return dot(rotation, i, pose[0, j], pose[1, j], pose[2, j])


@compiled
def twist_length(rotation, position, pose):
    """Return the length of the twist (m and rad) from a frame to a pose (4, 4), in that frame.

    With the rotation vector w of the relative rotation, and its angle a, and the relative translation p, the twist is w
    and p - w x p / 2 + (1 - a / 2 cot(a / 2)) w x (w x p) / a^2.
    """
    a, b, c = pose[0, 3] - position[0], pose[1, 3] - position[1], pose[2, 3] - position[2]
    p_x, p_y, p_z = dot(rotation, 0, a, b, c), dot(rotation, 1, a, b, c), dot(rotation, 2, a, b, c)
    w_x = (relative(rotation, pose, 2, 1) - relative(rotation, pose, 1, 2)) / 2
    w_y = (relative(rotation, pose, 0, 2) - relative(rotation, pose, 2, 0)) / 2
    w_z = (relative(rotation, pose, 1, 0) - relative(rotation, pose, 0, 1)) / 2
    trace = relative(rotation, pose, 0, 0) + relative(rotation, pose, 1, 1) + relative(rotation, pose, 2, 2)
    sine = math.sqrt(w_x * w_x + w_y * w_y + w_z * w_z)
    angle = math.atan2(sine, (trace - 1) / 2)
    bend = 1 / 12
    if angle > 1e-4:
        stretch = angle / sine
        w_x, w_y, w_z = w_x * stretch, w_y * stretch, w_z * stretch
        bend = (1 - angle / 2 / math.tan(angle / 2)) / (angle * angle)
    x, y, z = w_y * p_z - w_z * p_y, w_z * p_x - w_x * p_z, w_x * p_y - w_y * p_x
    u = p_x - x / 2 + bend * (w_y * z - w_z * y)
    v = p_y - y / 2 + bend * (w_z * x - w_x * z)
    s = p_z - z / 2 + bend * (w_x * y - w_y * x)
    return math.sqrt(angle * angle + u * u + v * v + s * s)


@compiled
def tip_pose(joints, q, rotations, origins, rotation, position):
    """Compute orientation (3, 3) and position (3,) of the end-effector at q (dof,)."""
    forward(joints, q, rotations, origins)
    tip_of(joints, rotations, origins, position)
    last = len(joints) - 1
    tip = joints[last].tip_rotation
    for i in range(3):
        x, y, z = rotations[last, i, 0], rotations[last, i, 1], rotations[last, i, 2]
        for j in range(3):
            rotation[i, j] = x * tip[0, j] + y * tip[1, j] + z * tip[2, j]


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
def choose(joints, pose, candidates, approximate, seed, tolerances, solutions, residuals):
    """Choose the `candidates` (k, dof) for a `pose` (4, 4) that are within the limits, the nearest to `seed` first.

    They are written to `solutions` (k + 1, dof), with their `residuals` (k + 1,), and the one of least residual to
    the last rows. Returns their number. It is -1 if that does not suffice: none is exact, a residual is above `exact`,
    or that of `seed` (dof,) below `near`. Solutions nearer to each other than `distinct` count once. `tolerances` are
    these three.
    """
    exact, near, distinct = tolerances
    dof, last = len(joints), len(candidates)
    rotations, origins = np.empty((dof, 3, 3)), np.empty((dof, 3))
    rotation, position, q = np.empty((3, 3)), np.empty(3), np.empty(dof)
    distances = np.empty(last)
    tip_pose(joints, seed, rotations, origins, rotation, position)
    if twist_length(rotation, position, pose) < near:
        return -1
    count, residuals[last] = 0, np.inf
    for row in range(last):
        if approximate[row]:
            continue
        tip_pose(joints, candidates[row], rotations, origins, rotation, position)
        residual = twist_length(rotation, position, pose)
        if not residual < exact:
            return -1
        nearest_turn(joints, candidates[row], seed, q)
        if residual < residuals[last]:
            residuals[last] = residual
            copy_to(q, solutions[last])
        within, distance, at = True, 0.0, count
        for i in range(dof):
            within = within and joints[i].lower <= q[i] <= joints[i].upper
            distance = max(distance, abs(q[i] - seed[i]))
        if not within or not is_distinct(q, solutions, count, distinct):
            continue
        while at > 0 and distances[at - 1] > distance:
            distances[at], residuals[at] = distances[at - 1], residuals[at - 1]
            copy_to(solutions[at - 1], solutions[at])
            at -= 1
        distances[at], residuals[at] = distance, residual
        copy_to(q, solutions[at])
        count += 1
    return count if residuals[last] < np.inf else -1
