"""Forward kinematics of several configurations at once, each in a lane of the processor's vectors.

The loops over lanes have constant bounds and no branches, so that LLVM makes vector instructions of them. Joints and
their matrices are those of `armctl.kernels.arm`.
"""

import math

import numpy as np

from armctl.kernels.arm import row_of_turn
from armctl.kernels.compiling import fused, inlined

LANES = 16
"""Configurations in one computation. LLVM makes no vectors of shorter loops over arrays that may overlap."""
FRAMES = np.dtype(
    [
        *(("rotation", float, (3, 3, LANES)), ("position", float, (3, LANES))),
        *((name, float, (3, LANES)) for name in ("rotation_error", "translation_error")),
        ("cosine", float, LANES),
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
    """Return sin(angle) and 1 - cos(angle), to 4e-16 up to 1e4 rad."""
    half_turns = (angle / math.pi + ROUNDING) - ROUNDING
    is_odd = (half_turns - 2 * ((half_turns / 2 + ROUNDING) - ROUNDING)) ** 2
    x = (angle - half_turns * PI_HIGH) - half_turns * PI_LOW
    sine, versine = x * polynomial(x * x, SINE), x * x * polynomial(x * x, VERSINE)
    return sine - 2 * is_odd * sine, versine + 2 * is_odd * (1 - versine)


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
def move_by_joint(lanes, joint, q):
    """Move the frames by a joint whose motor is at q (LANES,)."""
    for lane in range(LANES):
        angle = joint.ratio * q[lane] + joint.shift
        sine, versine = sine_and_versine(angle)
        step = (
            joint.offset[0] + angle * joint.slide[0],
            joint.offset[1] + angle * joint.slide[1],
            joint.offset[2] + angle * joint.slide[2],
        )
        turn = (
            row_of_turn(joint, 0, sine, versine),
            row_of_turn(joint, 1, sine, versine),
            row_of_turn(joint, 2, sine, versine),
        )
        move(lanes, lane, step, turn)


@fused
def move_to_tip(lanes, joint):
    """Move the frames from the last joint to the end-effector."""
    for lane in range(LANES):
        turn = row_of_tip(joint, 0), row_of_tip(joint, 1), row_of_tip(joint, 2)
        move(lanes, lane, joint.tip, turn)


@inlined
def row_of_tip(joint, i):
    """Return row i of the end-effector's rotation in the last joint's frame."""
    return joint.tip_rotation[i, 0], joint.tip_rotation[i, 1], joint.tip_rotation[i, 2]


@fused
def tip_frames(joints, q, lanes):
    """Compute the end-effector's frames at q (dof, LANES)."""
    for i in range(3):
        for lane in range(LANES):
            lanes.position[i, lane] = 0.0
            for j in range(3):
                lanes.rotation[i, j, lane] = 1.0 if i == j else 0.0
    for k in range(len(joints)):
        move_by_joint(lanes, joints[k], q[joints[k].motor])
    move_to_tip(lanes, joints[len(joints) - 1])


@inlined
def relative(lanes, lane, i, pose, j):
    """Return the product of a frame's axis i and column j of a pose."""
    r = lanes.rotation
    return r[0, i, lane] * pose[0, j] + r[1, i, lane] * pose[1, j] + r[2, i, lane] * pose[2, j]


@fused
def pose_errors(lanes, pose):
    """Compute the transforms from the frames to a pose (4, 4), in the frames.

    Of a rotation by an angle, `rotation_error` is its axis times the sine, and `cosine` the cosine.
    """
    for lane in range(LANES):
        trace = 0.0
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            trace += relative(lanes, lane, i, pose, i)
            lanes.rotation_error[i, lane] = (relative(lanes, lane, k, pose, j) - relative(lanes, lane, j, pose, k)) / 2
            lanes.translation_error[i, lane] = (
                lanes.rotation[0, i, lane] * (pose[0, 3] - lanes.position[0, lane])
                + lanes.rotation[1, i, lane] * (pose[1, 3] - lanes.position[1, lane])
                + lanes.rotation[2, i, lane] * (pose[2, 3] - lanes.position[2, lane])
            )
        lanes.cosine[lane] = (trace - 1) / 2


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
