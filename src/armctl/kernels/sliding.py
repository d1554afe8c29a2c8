"""Motions along obstacles: the displacement nearest to a desired one that brings no pair of shapes too near.

About a configuration, distances are nearly linear, so each bounds displacements by a half-space (Faverjon and
Tournassoud, "A local based approach for path planning of manipulators with a high number of degrees of freedom", ICRA
1987). The projection onto all of them is Hildreth's ("A quadratic programming procedure", Naval Research Logistics
Quarterly 4, 1957).
"""

import numpy as np

from armctl.kernels.compiling import compiled
from armctl.kernels.edges import measure, measure_all

STEP = 1e-4
"""rad: step of finite differences."""
SWEEPS = 40
"""Passes over all half-spaces."""


@compiled
def slide(scene, motion, q, required, moved):
    """Change a displacement `moved` (dof,) from q (dof,) to the nearest that leaves pairs their `required` (pairs,) m.

    `motion` (pairs, dof) bounds how far a joint moves a pair, m/rad: pairs that it cannot bring too near are left out.
    """
    dof, num_pairs = len(q), len(scene.pairs)
    apart, shifted, place, gradients = np.empty(num_pairs), np.empty(num_pairs), q.copy(), np.empty((num_pairs, dof))
    no_margins = np.full(num_pairs, -np.inf)
    measure_all(scene, q, apart)
    near = np.zeros(num_pairs, dtype=np.bool_)
    for k in range(num_pairs):
        reach = 0.0
        for j in range(dof):
            reach += motion[k, j] * abs(moved[j])
        near[k] = apart[k] - reach < required[k]
        shifted[k] = 0.0 if near[k] else np.inf
    for j in range(dof):
        place[j] = q[j] + STEP
        measure(scene.joints, scene.links, scene.pairs, scene.boxes, place, no_margins, shifted)
        place[j] = q[j]
        for k in range(num_pairs):
            gradients[k, j] = (shifted[k] - apart[k]) / STEP
    multipliers = np.zeros(num_pairs)
    for _ in range(SWEEPS):
        for pair in np.flatnonzero(near):
            square = 0.0
            lack = required[pair] - apart[pair]
            for j in range(dof):
                square += gradients[pair, j] ** 2
                lack -= gradients[pair, j] * moved[j]
            if square > 0:
                change = max(lack / square, -multipliers[pair])
                multipliers[pair] += change
                for j in range(dof):
                    moved[j] += change * gradients[pair, j]
