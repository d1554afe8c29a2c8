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

from armctl.kernels.compiling import compiled, inlined

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


@inlined
def row_of_turn(joint, i, sine, versine):
    """Return row i of a joint's rotation."""
    return (
        joint.base[i, 0] + sine * joint.sine[i, 0] + versine * joint.versine[i, 0],
        joint.base[i, 1] + sine * joint.sine[i, 1] + versine * joint.versine[i, 1],
        joint.base[i, 2] + sine * joint.sine[i, 2] + versine * joint.versine[i, 2],
    )


@compiled
def forward(joints, q, rotations, origins):
    """Compute the frames of all joints at q (dof,)."""
    for k in range(len(joints)):
        joint = joints[k]
        angle = joint.ratio * q[joint.motor] + joint.shift
        sine, versine = math.sin(angle), 1 - math.cos(angle)
        along_x = joint.offset[0] + angle * joint.slide[0]
        along_y = joint.offset[1] + angle * joint.slide[1]
        along_z = joint.offset[2] + angle * joint.slide[2]
        xx, xy, xz = row_of_turn(joint, 0, sine, versine)
        yx, yy, yz = row_of_turn(joint, 1, sine, versine)
        zx, zy, zz = row_of_turn(joint, 2, sine, versine)
        if k == 0:
            origins[0, 0], origins[0, 1], origins[0, 2] = along_x, along_y, along_z
            rotations[0, 0, 0], rotations[0, 0, 1], rotations[0, 0, 2] = xx, xy, xz
            rotations[0, 1, 0], rotations[0, 1, 1], rotations[0, 1, 2] = yx, yy, yz
            rotations[0, 2, 0], rotations[0, 2, 1], rotations[0, 2, 2] = zx, zy, zz
            continue
        for i in range(3):
            x, y, z = rotations[k - 1, i, 0], rotations[k - 1, i, 1], rotations[k - 1, i, 2]
            rotations[k, i, 0] = x * xx + y * yx + z * zx
            rotations[k, i, 1] = x * xy + y * yy + z * zy
            rotations[k, i, 2] = x * xz + y * yz + z * zz
            origins[k, i] = origins[k - 1, i] + x * along_x + y * along_y + z * along_z


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
