"""Bodies whose place differs between episodes on a bridge: jersey barriers, blocks and walkers, in n worlds at once."""

from collections.abc import Sequence

import numpy as np

from armctl.core.arrays import Array
from armctl.kernels.control_step import PoseInput
from armctl.simulation import Simulation
from armctl.simulation.box_geoms import BoxGeoms
from armctl.tasks.bridge.layout import Layout
from armctl.tasks.bridge.options import MOVES, BridgeOptions
from armctl.tasks.bridge.world import BLOCK_HEIGHT, HIDDEN, block_names, segment_names, walker_names
from armctl.tasks.task import Ids


class Furniture:
    """The bodies of barriers, blocks and walkers on bridges; walkers move `MOVES` times a control step."""

    def __init__(self, simulation: Simulation, options: BridgeOptions) -> None:
        model, blocks = simulation.model, block_names(options.blocks)
        self._positions, self._rotations = (simulation.per_world(name) for name in ("body_pos", "body_quat"))
        self._barriers, self._blocks, self._walkers = (
            np.array([model.body(name).id for name in names], dtype=int)
            for names in (segment_names(options.deck_length), blocks, walker_names(options.walkers))
        )
        self._resized = BoxGeoms(simulation, model.body_geomadr[self._blocks]) if options.blocks_vary else None
        self.poses = PoseInput(
            self._walkers.astype(np.intp), np.zeros((MOVES, simulation.n, options.walkers, 2)), self._positions
        )
        """The walkers in the ticks of `Simulation.control_step`."""

    def place(self, ids: Ids, layouts: Sequence[Layout]) -> None:
        """Put barriers and blocks of worlds `ids` where their layouts have them, and walkers on the deck."""
        worlds = ids[:, None]
        x, y, yaw, half_length, half_width = np.moveaxis(np.array([layout.map.blocks for layout in layouts]), -1, 0)
        self._positions[worlds, self._barriers, 2] = 0.0
        self._positions[worlds, self._barriers[np.array([layout.missing for layout in layouts])], 2] = HIDDEN
        self._positions[worlds, self._blocks] = np.stack((x, y, np.where(half_length > 0, 0.0, HIDDEN)), axis=-1)
        turned = np.stack((np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)), axis=-1)
        self._rotations[worlds, self._blocks] = turned
        if self._resized:
            heights = np.full(half_length.shape, BLOCK_HEIGHT / 2)
            self._resized.resize(ids, np.stack((half_length, half_width, heights), axis=-1))
        moving = np.array([layout.map.pedestrians.speed for layout in layouts]) > 0
        self._positions[worlds, self._walkers, 2] = np.where(moving, 0.0, HIDDEN)

    def move_walkers(self, ids: Ids, positions: Array) -> None:
        """Put the walkers of worlds `ids` at `positions` (len(ids), walkers, 2), m."""
        self.poses.positions[:, ids] = self._positions[ids[:, None], self._walkers, :2] = positions
