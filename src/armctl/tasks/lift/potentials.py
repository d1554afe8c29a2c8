"""A potential of lift tasks for reward shaping."""

import numpy as np

from armctl.core.arrays import Array
from armctl.tasks.task import Ids, Potential

TO_OBJECT = 0.5
"""Weight of the hand's distance from the object, relative to the object's from its height."""


class LiftDistance(Potential):
    """Minus the object's distance from its height, and half the hand's from the object, m."""

    def potentials(self, ids: Ids) -> Array:
        """Return (len(ids),) m."""
        state = self.task.state
        apart = np.linalg.norm((state.object_position - state.end_effector_position)[ids], axis=1)
        return np.asarray(-state.distance[ids] - TO_OBJECT * apart)
