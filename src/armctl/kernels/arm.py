"""Kinematics of a serial arm.

An arm is an array (joints,) of `JOINT`: of each joint's frame in the one before it, at angle q,

    rotation = base + sin(q) sine + (1 - cos(q)) versine,   origin = offset

by Rodrigues' formula; of a joint that `slides`, rotation = base and origin = offset + q slide. `tip` and `tip_rotation`
of the last one are the end-effector's position and axes in its frame. An arm's q (dof,) is that of its motors: the
angle of a joint is `ratio` q[`motor`] + `shift`, so that there are more joints than motors if some follow others. The
first dof joints have the motors' limits, whichever these move.
Frames in the base are `rotations` (joints, 3, 3) and `origins` (joints, 3).
"""

import math

import numpy as np

from armctl.kernels.compiling import compiled

MATRIX, VECTOR = (float, (3, 3)), (float, 3)
JOINT = np.dtype(
    [
        *((name, *MATRIX) for name in ("base", "sine", "versine")),
        *((name, *VECTOR) for name in ("offset", "axis", "tip")),
        ("tip_rotation", *MATRIX),
        *((name, float) for name in ("lower", "upper", "top", "acceleration")),
        ("slides", int),
        ("slide", *VECTOR),
        ("motor", int),
        *((name, float) for name in ("ratio", "shift")),
    ]
)


@compiled
def forward(joints, q, rotations, origins):
    """Compute the frames of all joints at q (dof,)."""
    turn = np.empty((3, 3))
    for k in range(len(joints)):
        joint = joints[k]
        angle = joint.ratio * q[joint.motor] + joint.shift
        sine, versine = math.sin(angle), 1 - math.cos(angle)
        offset = (
            joint.offset[0] + angle * joint.slide[0],
            joint.offset[1] + angle * joint.slide[1],
            joint.offset[2] + angle * joint.slide[2],
        )
        for i in range(3):
            for j in range(3):
                turn[i, j] = joint.base[i, j] + sine * joint.sine[i, j] + versine * joint.versine[i, j]
        if k == 0:
            for i in range(3):
                origins[0, i] = offset[i]
                for j in range(3):
                    rotations[0, i, j] = turn[i, j]
            continue
        for i in range(3):
            x, y, z = rotations[k - 1, i]
            for j in range(3):
                rotations[k, i, j] = x * turn[0, j] + y * turn[1, j] + z * turn[2, j]
            origins[k, i] = origins[k - 1, i] + x * offset[0] + y * offset[1] + z * offset[2]


@compiled
def carried(rotation, origin, point, out):
    """Transform a point (3,) of a frame into the base."""
    for i in range(3):
        out[i] = origin[i] + rotation[i, 0] * point[0] + rotation[i, 1] * point[1] + rotation[i, 2] * point[2]


@compiled
def turned(rotation, vector, out):
    """Rotate a vector (3,) of a frame into the base."""
    for i in range(3):
        out[i] = rotation[i, 0] * vector[0] + rotation[i, 1] * vector[1] + rotation[i, 2] * vector[2]


@compiled
def cross(a, b, out):
    """Compute the cross product of a and b (3,)."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def tip_of(joints, rotations, origins, out):
    """Compute the end-effector position (3,)."""
    last = len(joints) - 1
    carried(rotations[last], origins[last], joints[last].tip, out)


@compiled
def axes_of(joints, rotations, axes):
    """Compute the axes (joints, 3) of the joints."""
    for k in range(len(joints)):
        turned(rotations[k], joints[k].axis, axes[k])


@compiled
def gradient_of(joint, axis, origin, point):
    """Return the motion of a point by a joint, m/rad: axis x (point - origin), or axis if the joint slides."""
    if joint.slides:
        return axis[0], axis[1], axis[2]
    x, y, z = point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]
    return axis[1] * z - axis[2] * y, axis[2] * x - axis[0] * z, axis[0] * y - axis[1] * x


@compiled
def gradients_of(joints, axes, origins, point, out):
    """Compute the motion (dof, 3) of a point of the last link by each motor, m/rad."""
    for i in range(len(out)):
        out[i, 0] = out[i, 1] = out[i, 2] = 0.0
    for k in range(len(joints)):
        joint = joints[k]
        x, y, z = gradient_of(joint, axes[k], origins[k], point)
        out[joint.motor, 0] += joint.ratio * x
        out[joint.motor, 1] += joint.ratio * y
        out[joint.motor, 2] += joint.ratio * z


@compiled
def number_of_motors(joints):
    """Return the dof of an arm."""
    last = -1
    for k in range(len(joints)):
        last = max(last, joints[k].motor)
    return last + 1


@compiled
def workspace(joints):
    """Allocate memory for `linearise`: frames, axes, the end-effector's position, and how the motors move it."""
    count, dof = len(joints), number_of_motors(joints)
    return np.empty((count, 3, 3)), np.empty((count, 3)), np.empty((count, 3)), np.empty(3), np.empty((dof, 3))


@compiled
def linearise(joints, q, memory):
    """Return the end-effector position (3,) at q (dof,), and how the motors move it, (dof, 3) m/rad."""
    rotations, origins, axes, tip, gradients = memory
    forward(joints, q, rotations, origins)
    tip_of(joints, rotations, origins, tip)
    axes_of(joints, rotations, axes)
    gradients_of(joints, axes, origins, tip, gradients)
    return tip, gradients


@compiled
def tips(joints, q, out):
    """Compute the end-effector positions (n, 3) of q (n, dof)."""
    rotations, origins = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    for row in range(len(q)):
        forward(joints, q[row], rotations, origins)
        tip_of(joints, rotations, origins, out[row])


@compiled
def segments(joints, q, out):
    """Compute the vectors (joints + 1, 3) from the base over all joints to the end-effector: they sum to its place."""
    rotations, origins, tip = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3)), np.empty(3)
    forward(joints, q, rotations, origins)
    tip_of(joints, rotations, origins, tip)
    for i in range(3):
        out[0, i] = origins[0, i]
        for k in range(1, len(joints)):
            out[k, i] = origins[k, i] - origins[k - 1, i]
        out[len(joints), i] = tip[i] - origins[len(joints) - 1, i]
