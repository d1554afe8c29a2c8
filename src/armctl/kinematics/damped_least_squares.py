"""The step that every iterative inverse kinematics here takes: damped least squares.

Wampler, "Manipulator inverse kinematic solutions based on vector formulations and damped least-squares methods", IEEE
Trans. Systems, Man, and Cybernetics 16, 1986. The dual form inverts a matrix of the size of the task, not of the arm.
"""

import numpy as np

from armctl.core.arrays import Array


def damped_step(jacobian: Array, error: Array, damping: Array | float) -> Array:
    """Return J^T (J J^T + damping I)^-1 error, (..., dof).

    Args: `jacobian` (..., m, dof), `error` (..., m), `damping` (...), in squared units of the Jacobian.
    """
    transposed = jacobian.swapaxes(-1, -2)
    gram = jacobian @ transposed + np.asarray(damping)[..., None, None] * np.eye(error.shape[-1])
    return np.asarray((transposed @ np.linalg.solve(gram, error[..., None]))[..., 0])
