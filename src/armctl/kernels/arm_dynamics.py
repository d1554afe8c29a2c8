"""Motion of an arm's joints behind their drives: rigid bodies on servos whose torques are limited.

An arm is an array (dof,) of `armctl.kernels.arm.JOINT`, and one of `BODY`: what each joint carries along, and its
servo. Composite bodies give the mass matrix, and the Newton-Euler equations the rest (Featherstone, "Rigid Body
Dynamics Algorithms", 2008, chapters 5 and 6), with vectors in the base's frame and moments about its origin.
"""

from typing import NamedTuple

import numpy as np

from armctl.core.arrays import Array
from armctl.kernels.arm import MATRIX, VECTOR, forward
from armctl.kernels.compiling import compiled, copy_to, inlined

BODY = np.dtype(
    [
        ("mass", float), ("centre", *VECTOR), ("inertia", *MATRIX),
        *((name, float) for name in ("stiffness", "damping", "effort")),
    ]
)  # fmt: skip
"""kg; m and kg m^2 about the centre, both in the joint's frame; N m/rad, N m s/rad and N m of its servo."""
GRAVITY = 9.81
"""m/s^2."""


class Joints(NamedTuple):
    """State of the joints (dof,), and where they are; `place_joints` computes the second from the first."""

    q: Array
    velocity: Array
    rotations: Array
    origins: Array


class Composite(NamedTuple):
    """All that each joint carries along, moments about the base's origin."""

    mass: Array
    """(dof,) kg."""
    first: Array
    """(dof, 3) kg m: sum of mass times place."""
    second: Array
    """(dof, 3, 3) kg m^2: moment of inertia."""
    force: Array
    """(dof, 3) N, which velocities need, as `moment`."""
    moment: Array
    """(dof, 3) N m."""


class Equations(NamedTuple):
    """Equations of motion: mass @ acceleration + bias + weight = torques."""

    mass: Array
    """(dof, dof) kg m^2."""
    lower: Array
    """(dof, dof) memory."""
    bias: Array
    """(dof,) N m, which velocities need."""
    weight: Array
    """(dof,) N m, which hold the arm."""
    torques: Array
    """(dof,) memory, as `damping`."""
    damping: Array
    composite: Composite
    axes: Array
    """(dof, 3) angular velocity by each joint."""
    levers: Array
    """(dof, 3) m: velocity of the base's origin, moving along, by each joint."""


@compiled
def joints_of(dof):
    """Return memory for the state of joints."""
    return Joints(np.empty(dof), np.empty(dof), np.empty((dof, 3, 3)), np.empty((dof, 3)))


@compiled
def equations_of(dof):
    """Return memory for equations of motion."""
    composite = Composite(
        np.empty(dof), np.empty((dof, 3)), np.empty((dof, 3, 3)), np.empty((dof, 3)), np.empty((dof, 3))
    )
    return Equations(
        np.empty((dof, dof)), np.empty((dof, dof)), np.empty(dof), np.empty(dof), np.empty(dof), np.empty(dof),
        composite, np.empty((dof, 3)), np.empty((dof, 3)),
    )  # fmt: skip


@inlined
def dot(a, b):
    """Return the scalar product of vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def plus(a, b, share=1.0):
    """Return a + share b of vectors (3,)."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@inlined
def crossed(a, b):
    """Return the cross product of vectors (3,)."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def times(matrix, vector):
    """Return the product of a matrix (3, 3) and a vector (3,)."""
    return (
        matrix[0, 0] * vector[0] + matrix[0, 1] * vector[1] + matrix[0, 2] * vector[2],
        matrix[1, 0] * vector[0] + matrix[1, 1] * vector[1] + matrix[1, 2] * vector[2],
        matrix[2, 0] * vector[0] + matrix[2, 1] * vector[1] + matrix[2, 2] * vector[2],
    )


@inlined
def add_body(body, k, state, motion, composite):
    """Set row k of `composite` to one body, and what it needs to move as `motion` says, four vectors.

    These are angular velocity, velocity, angular acceleration and acceleration of the base's origin, moving along.
    """
    rotation, inertia, (angular, linear, turning, lifting) = state.rotations[k], composite.second[k], motion
    centre = plus(times(rotation, body.centre), state.origins[k])
    for i in range(3):
        row = rotation[i, 0], rotation[i, 1], rotation[i, 2]
        moments = times(body.inertia, row)
        for j in range(3):
            inertia[i, j] = moments[0] * rotation[j, 0] + moments[1] * rotation[j, 1] + moments[2] * rotation[j, 2]
    speed = plus(crossed(angular, centre), linear)
    force = plus(plus(crossed(angular, speed), crossed(turning, centre)), lifting)
    force = force[0] * body.mass, force[1] * body.mass, force[2] * body.mass
    moment = plus(crossed(angular, times(inertia, angular)), times(inertia, turning))
    moment = plus(moment, crossed(centre, force))
    square = dot(centre, centre)
    composite.mass[k] = body.mass
    for i in range(3):
        composite.first[k, i] = body.mass * centre[i]
        composite.force[k, i], composite.moment[k, i] = force[i], moment[i]
        for j in range(3):
            inertia[i, j] += body.mass * ((square if i == j else 0.0) - centre[i] * centre[j])


@compiled
def add_bodies(joints, bodies, state, equations):
    """Compute `axes` and `levers` of equations, and `composite` of each body alone."""
    rest = 0.0, 0.0, 0.0
    angular, linear, turning, lifting = rest, rest, rest, rest
    for k in range(len(joints)):
        velocity = state.velocity[k]
        axis = times(state.rotations[k], joints[k].axis)
        lever = crossed(state.origins[k], axis)
        for i in range(3):
            equations.axes[k, i], equations.levers[k, i] = axis[i], lever[i]
        angular, linear = plus(angular, axis, velocity), plus(linear, lever, velocity)
        turning = plus(turning, crossed(angular, axis), velocity)
        lifting = plus(plus(lifting, crossed(linear, axis), velocity), crossed(angular, lever), velocity)
        add_body(bodies[k], k, state, (angular, linear, turning, lifting), equations.composite)


@compiled
def compute_equations(joints, bodies, state, equations):
    """Compute the equations of motion at a state of the joints, with their places."""
    add_bodies(joints, bodies, state, equations)
    mass, first, second, force, moment = equations.composite
    dof = len(joints)
    for k in range(dof - 1, -1, -1):
        axis, lever = equations.axes[k], equations.levers[k]
        if k + 1 < dof:
            mass[k] += mass[k + 1]
            for i in range(3):
                first[k, i] += first[k + 1, i]
                force[k, i] += force[k + 1, i]
                moment[k, i] += moment[k + 1, i]
                for j in range(3):
                    second[k, i, j] += second[k + 1, i, j]
        equations.bias[k] = dot(axis, moment[k]) + dot(lever, force[k])
        equations.weight[k] = GRAVITY * (axis[0] * first[k, 1] - axis[1] * first[k, 0] + lever[2] * mass[k])
        linear = plus(crossed(axis, first[k]), lever, mass[k])
        angular = plus(crossed(first[k], lever), times(second[k], axis))
        for j in range(k + 1):
            coupling = dot(equations.axes[j], angular) + dot(equations.levers[j], linear)
            equations.mass[j, k] = equations.mass[k, j] = coupling


@inlined
def factor(matrix):
    """Factor a positive definite matrix (n, n) in place: its lower triangle becomes Cholesky's."""
    for j in range(len(matrix)):
        for i in range(j, len(matrix)):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = np.sqrt(total) if i == j else total / matrix[j, j]


@inlined
def solve(lower, values):
    """Solve lower lower^T x = values (n,) in place."""
    n = len(values)
    for i in range(n):
        for k in range(i):
            values[i] -= lower[i, k] * values[k]
        values[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            values[i] -= lower[k, i] * values[k]
        values[i] /= lower[i, i]


@inlined
def place_joints(joints, state):
    """Compute where joints are."""
    forward(joints, state.q, state.rotations, state.origins)


@compiled
def follow_drives(joints, bodies, state, drives, equations, step, moved):
    """Move joints by a tick behind their `drives`: positions (dof,), which are moved on, and velocities (dof,).

    `step` is the time step, s, and the number of steps in the tick. `moved` (dof,) becomes the ways of the joints.
    Servos damp as they do at the end of a step, unless they are at the limit of their torque, as in MuJoCo's integrator
    `implicitfast`.
    """
    dof, (position, speed), (timestep, steps) = len(joints), drives, step
    torques, lower = equations.torques, equations.lower
    compute_equations(joints, bodies, state, equations)
    for i in range(dof):
        moved[i] = 0.0
    for step in range(steps):
        is_same = step > 0
        for i in range(dof):
            servo = bodies[i].stiffness * (position[i] - state.q[i])
            servo += bodies[i].damping * (speed[i] - state.velocity[i]) + equations.weight[i]
            damping = timestep * bodies[i].damping if abs(servo) <= bodies[i].effort else 0.0
            is_same &= damping == equations.damping[i]
            equations.damping[i] = damping
            servo = min(max(servo, -bodies[i].effort), bodies[i].effort)
            torques[i] = timestep * (servo - equations.weight[i] - equations.bias[i])
        if not is_same:
            for i in range(dof):
                copy_to(equations.mass[i], lower[i])
                lower[i, i] += equations.damping[i]
            factor(lower)
        solve(lower, torques)
        for i in range(dof):
            state.velocity[i] += torques[i]
            state.q[i] += timestep * state.velocity[i]
            position[i] += timestep * speed[i]
            moved[i] += timestep * abs(state.velocity[i])
    place_joints(joints, state)
