"""Accelerations that an arm's motors can give it: what is assumed where nobody states any."""

import numpy as np
import pinocchio

from armctl.core.arrays import Array

CONFIGURATIONS = 200
"""Random configurations in which masses and gravity are measured."""
MIN_ACCELERATION = 1.0
"""rad/s^2: for joints whose motors hardly hold the arm."""


def possible_accelerations(urdf: str, highest: float) -> Array:
    """Return accelerations (dof,) that motors can give all joints at once, besides holding the arm; at most `highest`.

    By the joints' effort limits and the mass matrix M of a URDF (`ArmDescription.urdf`), rad/s^2: the least, over
    configurations, of (effort_i - |gravity_i|) / sum_j |M_ij|.
    """
    model = pinocchio.buildModelFromXML(urdf)
    data = model.createData()
    low, high = np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi)
    accelerations = []
    for q in np.random.default_rng(0).uniform(low, high, (CONFIGURATIONS, model.nq)):
        upper = np.triu(pinocchio.crba(model, data, q))
        inertia = np.abs(upper + np.triu(upper, 1).T).sum(axis=1)
        gravity = np.abs(pinocchio.computeGeneralizedGravity(model, data, q))
        accelerations.append((model.effortLimit - gravity) / inertia)
    return np.asarray(np.clip(np.min(accelerations, axis=0), min(MIN_ACCELERATION, highest), highest))
