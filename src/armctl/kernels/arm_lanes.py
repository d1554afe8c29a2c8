"""Forward kinematics of several configurations at once, each in a lane of the processor's vectors.

The loops over lanes have constant bounds and no branches, so that LLVM makes vector instructions of them. All but the
lanes is read before, since LLVM makes none of short loops over arrays that may overlap. Joints and their matrices are
those of `armctl.kernels.arm`.
"""

import math

import numpy as np

from armctl.kernels.compiling import fused, inlined

LANES = 12
"""Configurations in one computation: the eight of a closed form and a seed fit."""
FRAMES = np.dtype(
    [
        *(("rotation", float, (3, 3, LANES)), ("position", float, (3, LANES))),
        *((name, float, (3, LANES)) for name in ("rotation_error", "translation_error")),
        *((name, float, LANES) for name in ("angle", "cosine")),
    ]
)
"""Memory for the frames of all lanes, and for their errors to a pose."""

PI_HIGH, PI_LOW = float.fromhex("0x1.921fb544p+1"), 1.2154201013012385e-10
"""Pi to 33 bits, whose products with small integers are exact, and the rest of it."""
ROUNDING = 1.5 * 2.0**52
"""Constant whose addition and subtraction round to an integer."""
SINE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(10))
VERSINE = tuple((-1) ** k / math.factorial(2 * k + 2) for k in range(10))
"""Taylor coefficients of sin(x) / x and (1 - cos(x)) / x^2 in x^2: to 2e-16 up to a quarter turn."""
SMALL_SINE = 1e-5
"""Sine of an angle that is the angle itself, to 2e-11 of it."""


@fused
def polynomial(x, c):
    """Return c[0] + c[1] x + ... + c[9] x^9."""
    low = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * c[4])))
    return low + x**5 * (c[5] + x * (c[6] + x * (c[7] + x * (c[8] + x * c[9]))))


@fused
def sine_and_versine(angle):
    """Return sin(angle) and 1 - cos(angle), to 1e-15 up to 1e4 rad."""
    half_turns = (angle / math.pi + ROUNDING) - ROUNDING
    is_odd = (half_turns - 2 * ((half_turns / 2 + ROUNDING) - ROUNDING)) ** 2
    x = (angle - half_turns * PI_HIGH) - half_turns * PI_LOW
    sine, versine = x * polynomial(x * x, SINE), x * x * polynomial(x * x, VERSINE)
    return sine - 2 * is_odd * sine, versine + 2 * is_odd * (1 - versine)


@inlined
def scalars(vector):
    """Return the entries of a vector (3,)."""
    return vector[0], vector[1], vector[2]


@inlined
def rows(matrix):
    """Return the entries of a matrix (3, 3), by rows."""
    return scalars(matrix[0]), scalars(matrix[1]), scalars(matrix[2])


@inlined
def combined(a, b, c, x, y):
    """Return a + x b + y c, of three numbers each."""
    return a[0] + x * b[0] + y * c[0], a[1] + x * b[1] + y * c[1], a[2] + x * b[2] + y * c[2]


@inlined
def move(lanes, lane, step, turn):
    """Move a lane's frame by a `step` along its axes, and then turn it by the rows of a rotation."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = turn
    for i in range(3):
        x, y, z = lanes.rotation[i, 0, lane], lanes.rotation[i, 1, lane], lanes.rotation[i, 2, lane]
        lanes.position[i, lane] += x * step[0] + y * step[1] + z * step[2]
        lanes.rotation[i, 0, lane] = x * xx + y * yx + z * zx
        lanes.rotation[i, 1, lane] = x * xy + y * yy + z * zy
        lanes.rotation[i, 2, lane] = x * xz + y * yz + z * zz


@fused
def move_by_joint(lanes, joint):
    """Move the frames by a joint at each lane's `angle`."""
    base, by_sine, by_versine = rows(joint.base), rows(joint.sine), rows(joint.versine)
    offset, slide = scalars(joint.offset), scalars(joint.slide)
    for lane in range(LANES):
        angle = lanes.angle[lane]
        sine, versine = sine_and_versine(angle)
        turn = (
            combined(base[0], by_sine[0], by_versine[0], sine, versine),
            combined(base[1], by_sine[1], by_versine[1], sine, versine),
            combined(base[2], by_sine[2], by_versine[2], sine, versine),
        )
        step = offset[0] + angle * slide[0], offset[1] + angle * slide[1], offset[2] + angle * slide[2]
        move(lanes, lane, step, turn)


@fused
def move_to_tip(lanes, joint):
    """Move the frames from the last joint to the end-effector."""
    step, turn = scalars(joint.tip), rows(joint.tip_rotation)
    for lane in range(LANES):
        move(lanes, lane, step, turn)


@fused
def tip_frames(joints, q, lanes):
    """Compute the end-effector's frames at q (dof, LANES)."""
    for i in range(3):
        for lane in range(LANES):
            lanes.position[i, lane] = 0.0
            for j in range(3):
                lanes.rotation[i, j, lane] = 1.0 if i == j else 0.0
    for k in range(len(joints)):
        for lane in range(LANES):
            lanes.angle[lane] = joints[k].ratio * q[joints[k].motor, lane] + joints[k].shift
        move_by_joint(lanes, joints[k])
    move_to_tip(lanes, joints[len(joints) - 1])


@inlined
def dot(a, b):
    """Return the product of two vectors of three numbers."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@fused
def pose_errors(lanes, pose):
    """Compute the transforms from the frames to a pose (4, 4), in the frames.

    Of a rotation by an angle, `rotation_error` is its axis times the sine, and `cosine` the cosine.
    """
    x, y, z, position = scalars(pose[:, 0]), scalars(pose[:, 1]), scalars(pose[:, 2]), scalars(pose[:, 3])
    for lane in range(LANES):
        a = lanes.rotation[0, 0, lane], lanes.rotation[1, 0, lane], lanes.rotation[2, 0, lane]
        b = lanes.rotation[0, 1, lane], lanes.rotation[1, 1, lane], lanes.rotation[2, 1, lane]
        c = lanes.rotation[0, 2, lane], lanes.rotation[1, 2, lane], lanes.rotation[2, 2, lane]
        shift = (
            position[0] - lanes.position[0, lane],
            position[1] - lanes.position[1, lane],
            position[2] - lanes.position[2, lane],
        )
        lanes.cosine[lane] = (dot(a, x) + dot(b, y) + dot(c, z) - 1) / 2
        lanes.rotation_error[0, lane] = (dot(c, y) - dot(b, z)) / 2
        lanes.rotation_error[1, lane] = (dot(a, z) - dot(c, x)) / 2
        lanes.rotation_error[2, lane] = (dot(b, x) - dot(a, y)) / 2
        lanes.translation_error[0, lane] = dot(a, shift)
        lanes.translation_error[1, lane] = dot(b, shift)
        lanes.translation_error[2, lane] = dot(c, shift)


@fused
def twist_length(lanes, lane):
    """Return the length of a lane's twist (m and rad) to the pose of `pose_errors`, in the lane's frame.

    With the rotation vector w and its angle a, and the relative translation p, the twist is w and
    p - w x p / 2 + (1 - a / 2 cot(a / 2)) w x (w x p) / a^2.
    """
    p, w = lanes.translation_error, lanes.rotation_error
    p_x, p_y, p_z = p[0, lane], p[1, lane], p[2, lane]
    w_x, w_y, w_z = w[0, lane], w[1, lane], w[2, lane]
    sine = math.sqrt(w_x * w_x + w_y * w_y + w_z * w_z)
    angle, bend = sine, 1 / 12
    if sine > SMALL_SINE or lanes.cosine[lane] < 0:
        angle = math.atan2(sine, lanes.cosine[lane])
        stretch = angle / sine
        w_x, w_y, w_z = w_x * stretch, w_y * stretch, w_z * stretch
        bend = (1 - angle / 2 / math.tan(angle / 2)) / (angle * angle)
    x, y, z = w_y * p_z - w_z * p_y, w_z * p_x - w_x * p_z, w_x * p_y - w_y * p_x
    u = p_x - x / 2 + bend * (w_y * z - w_z * y)
    v = p_y - y / 2 + bend * (w_z * x - w_x * z)
    s = p_z - z / 2 + bend * (w_x * y - w_y * x)
    return math.sqrt(angle * angle + u * u + v * v + s * s)
