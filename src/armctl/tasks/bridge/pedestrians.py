"""Pedestrians of n bridges who follow their trajectories, whatever the rovers do; those who react are a subclass."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armctl.core.arrays import Array
from armctl.scene import BridgeMap, PedestrianTrajectories
from armctl.tasks.bridge.layout import Layout
from armctl.tasks.task import Ids


class Pedestrians:
    """Pedestrians (n, w) on `lines`, whose arrays change when episodes begin."""

    def __init__(self, lines: PedestrianTrajectories) -> None:
        self.lines = lines

    def begin(self, ids: Ids, layouts: Sequence[Layout]) -> None:
        """Put those of worlds `ids` on the lines of their layouts, m."""
        for name, values in self.lines.arrays.items():
            values[ids] = [getattr(layout.map.pedestrians, name) for layout in layouts]

    def reset(self, ids: Ids) -> None:
        """Begin new episodes in worlds `ids`."""

    def on(self, bridge: BridgeMap, world: int) -> BridgeMap:
        """Return the map of a world's bridge, which has the pedestrians as they would go on from now."""
        return bridge

    def positions(self, times: Array) -> Array:
        """Return positions (n, w, 2) m at the present times (n,) s."""
        return self.lines.positions(times)

    def velocities(self, times: Array) -> Array:
        """Return velocities (n, w, 2) m/s at the present times (n,) s."""
        return self.lines.velocities(times)

    def walk(self, times: Array, rovers: Array, rover_speeds: Array) -> Array:
        """Walk for a control step, and return positions (m, n, w, 2) m at all `times` (1 + m, n) s but the first.

        The first are the present ones; in a world that stands still, all are the same. `rovers` (n, 3) are present
        poses x, y (m) and yaw (rad), and `rover_speeds` (n,) m/s.
        """
        return self.positions(times[1:])

    def note(self, times: Array, rovers: Array) -> None:
        """Take note of where all are at the end of a control step."""

    def closest(self, bridge: BridgeMap, world: int, times: ArrayLike, points: Array) -> float:
        """Return the least distance (m) of points (m, 2) from the pedestrians at these times (m,) s of an episode."""
        people = bridge.pedestrians
        distances = np.linalg.norm(people.positions(times) - points[:, None], axis=-1) - people.radius
        return float(distances.min(initial=np.inf))


def on_lines_like(lines: PedestrianTrajectories, num_envs: int) -> PedestrianTrajectories:
    """Return the pedestrians of one bridge on each of n bridges, in arrays of their own."""
    copies: dict[str, Any] = {name: np.stack([values] * num_envs) for name, values in lines.arrays.items()}
    return replace(lines, **copies)
