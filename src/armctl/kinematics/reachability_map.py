"""ReachabilityMap of an arm, looked up by where the end-effector is to be: a global search before a local one."""

import numpy as np
from numpy.typing import NDArray

from armctl.kinematics.minimum_time_reach import approach
from armctl.kinematics.model import ArmModel

Array = NDArray[np.float64]

POSTURES, LOOKED_UP, WORTH_TRYING = 4096, 128, 16
"""Free configurations; of them those with the tip nearest to the target; of these the soonest, which are tried."""
ITERATIONS = 4
"""Of Levenberg and Marquardt, from a posture looked up to one with the tip at the target."""
TIP_SPEED = 1.0
"""m/s with which the tip is expected to make up for what a posture looked up is off the target."""
ON_TARGET, MISS = 0.01, 10.0
"""m that a posture may be off in the end, and s that it is put back for more."""


class ReachabilityMap:
    """Configurations that an arm can take, looked up by where the end-effector is to be."""

    def __init__(self, model: ArmModel) -> None:
        self.model = model
        rng = np.random.default_rng(0)
        low, high = np.maximum(model.limits.lower, -np.pi), np.minimum(model.limits.upper, np.pi)
        drawn = (rng.uniform(low, high) for _ in range(50 * POSTURES))
        free = (q for q in drawn if model.is_free(q))
        self._q = np.array([q for q, _ in zip(free, range(POSTURES), strict=False)])
        self._positions = model.positions(self._q)

    def towards(self, target: Array, start: Array, among: ArmModel) -> Array:
        """The posture (dof,) with the tip at `target` (3,) that is soonest reached from `start` (dof,), freely."""
        limits, distance = self.model.limits, np.linalg.norm(self._positions - target, axis=1)
        near = np.argpartition(distance, LOOKED_UP)[:LOOKED_UP]
        time = self.model.least_time(start, self._q[near]) + distance[near] / TIP_SPEED
        best = approach(self.model, self._q[near[np.argsort(time)[:WORTH_TRYING]]], target, ITERATIONS)
        best = np.clip(best, limits.lower, limits.upper)
        off = np.linalg.norm(self.model.positions(best) - target, axis=1)
        best = best[np.argsort(self.model.least_time(start, best) + np.where(off < ON_TARGET, 0.0, MISS))]
        ways = np.linspace(1.0, 0.1, 10)[:, None]
        free = (q for q in best if all(among.is_free(place) for place in start + ways * (q - start)))
        return next(free, best[0])
