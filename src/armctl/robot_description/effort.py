"""Accelerations that an arm's motors can give it: what is assumed where nobody states any."""

from collections.abc import Iterator

import numpy as np
import pinocchio

from armctl.core.arrays import Array

CONFIGURATIONS = 200
"""Random configurations in which masses and gravity are measured."""
MIN_ACCELERATION = 1.0
"""rad/s^2: for joints whose motors hardly hold the arm."""


def possible_accelerations(urdf: str, highest: float, armature: Array | None = None) -> Array:
    """Return accelerations (dof,) that motors can give all joints at once, besides holding the arm; at most `highest`.

    By the joints' effort limits and the mass matrix M of a URDF (`ArmDescription.urdf`) with `armature` (dof,): the
    least, over configurations, of (effort_i - |gravity_i|) / sum_j |M_ij|, rad/s^2.
    """
    model = pinocchio.buildModelFromXML(urdf, mimic=True)
    accelerations = [
        (model.effortLimit - gravity) / inertia for gravity, inertia in torques_of(model, CONFIGURATIONS, armature)
    ]
    return np.asarray(np.clip(np.min(accelerations, axis=0), min(MIN_ACCELERATION, highest), highest))


def torques_of(model: pinocchio.Model, count: int, armature: Array | None = None) -> Iterator[tuple[Array, Array]]:
    """Yield gravity and row sums of the mass matrix, absolute values (dof,), in some random configurations.

    `armature` (dof,) is the inertia of motors at their joints, kg m^2.
    """
    data = model.createData()
    low, high = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    for q in np.random.default_rng(0).uniform(low, high, (count, model.nq)):
        upper = np.triu(pinocchio.crba(model, data, q))
        inertia = np.abs(upper + np.triu(upper, 1).T).sum(axis=1)
        gravity = np.abs(pinocchio.computeGeneralizedGravity(model, data, q))
        yield gravity, inertia if armature is None else inertia + armature
