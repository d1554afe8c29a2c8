"""A potential of push tasks for reward shaping."""

import numpy as np

from armctl.core.arrays import Array
from armctl.scene import push_table
from armctl.tasks.task import Ids, Potential

TO_TOOL = 0.5
"""Weight of the tool's distance from where it pushes, relative to the object's from its target."""


class PushDistance(Potential):
    """Minus the distance of the object from its target, and half the tool's from the place behind the object, m."""

    def potentials(self, ids: Ids) -> Array:
        """Return (len(ids),) m."""
        state = self.task.state
        place, offset = state.object_position[ids], (state.target_position - state.object_position)[ids]
        distance = np.hypot(*offset[:, :2].T)
        way = offset[:, :2] / np.maximum(distance, self.task.options.tolerance)[:, None]
        behind = place - push_table.STAND_OFF * np.column_stack((way, np.zeros(len(ids))))
        return np.asarray(-distance - TO_TOOL * np.linalg.norm(state.tool_position[ids] - behind, axis=1))
