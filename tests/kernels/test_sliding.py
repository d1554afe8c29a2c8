"""Motions along obstacles: as near to the desired ones as an exact method finds."""

import numpy as np
from scipy.optimize import nnls

from armctl.control.arm_filter import ArmFilter
from armctl.kernels.edges import measure_all
from armctl.kernels.sliding import slide
from armctl.kinematics import ArmModel, ArmShapes
from armctl.scene import NO_BOXES


def nearest(desired, gradients):
    """Lawson and Hanson's least distance programming, by nonnegative least squares."""
    system = np.vstack((gradients.T, -0.02 - gradients @ desired))
    residual = system @ nnls(system, np.eye(7)[6])[0] - np.eye(7)[6]
    return desired - residual[:6] / residual[6]


def test_the_displacement_is_the_nearest_that_keeps_linear_distances():
    shapes = ArmShapes(ArmModel("ur5"))
    arm = ArmFilter(shapes, NO_BOXES, np.ones((2, 6)), to_positions=True, margin=0.01, period=0.04).arm
    pairs, rng, bounded = len(arm.scene.pairs), np.random.default_rng(2), 0
    for _ in range(12):
        q, desired = rng.uniform(-1.5, 1.5, 6), rng.uniform(-0.2, 0.2, 6)
        apart, further = np.empty(pairs), np.empty(pairs)
        measure_all(arm.scene, q, apart)
        gradients = np.empty((pairs, 6))
        for joint in range(6):
            measure_all(arm.scene, q + 1e-4 * np.eye(6)[joint], further)
            gradients[:, joint] = (further - apart) / 1e-4
        required = apart - 0.02  # each may come 2 cm nearer
        moved = desired.copy()
        slide(arm.scene, arm.motion, q, required, moved)
        exact = nearest(desired, gradients)
        np.testing.assert_allclose(moved, exact, atol=2e-3)
        bounded += np.abs(exact - desired).max() > 0.01
    assert bounded >= 3
