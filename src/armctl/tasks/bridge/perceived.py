"""n bridges as policies that see the state believe them to be, where a disturbance acts on the state."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armctl.scene import BridgeMap
from armctl.tasks.bridge.observation import BLOCK, ROVER, WALKER
from armctl.tasks.bridge.state import BridgeState


@dataclass(frozen=True)
class PerceivedBridges:
    """Reads like a `BridgeTask`: its state and maps are what the numbers of `full_state` say, and true beyond these."""

    numbers: NDArray[np.float32]
    """(n, k) of `full_state`, with the disturbance."""
    truth: BridgeState
    true_map: Callable[[int], BridgeMap]
    """Function that returns a world's true one."""
    goal_x: float

    def state_observation(self) -> NDArray[np.float32]:
        """Return the numbers themselves."""
        return self.numbers

    @property
    def state(self) -> BridgeState:
        """The true state with the poses, velocities and distances that the numbers say."""
        x, y, cos, sin, *velocities = self.numbers[:, :ROVER].T.astype(float)
        poses = np.column_stack((x, y, np.arctan2(sin, cos)))
        return replace(self.truth, poses=poses, velocities=np.column_stack(velocities), distance=self.goal_x - x)

    def map(self, world: int) -> BridgeMap:
        """Return the map with the blocks of the numbers, and each pedestrian's line moved to fit the numbers."""
        true = self.true_map(world)
        people_from = ROVER + BLOCK * len(true.blocks)
        _, *numbers = np.split(self.numbers[world].astype(float), [ROVER, people_from])
        blocks, people = numbers[0].reshape(-1, BLOCK), numbers[1].reshape(-1, WALKER)[:, :2]
        blocks = np.column_stack((blocks[:, :3], np.maximum(blocks[:, 3:], 0.0)))
        walkers = true.pedestrians
        off = people - walkers.positions(self.truth.time[world])
        moved = walkers.moved_to(walkers.start + off, walkers.end + off)
        return replace(true, blocks=blocks, pedestrians=moved)
