"""n worlds of one MuJoCo model, stepped at once on all cores."""

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

Array = NDArray[np.float64]
WorldIds = NDArray[np.int32]


class Simulation:
    """A thin face over `mujoco.batch.Batch`; every world is bit-identical to one simulated alone.

    `model` has a keyframe, in which worlds start.
    """

    def __init__(self, model: mujoco.MjModel, n: int, threads: int = 0) -> None:
        self.model = model
        self._batch = Batch(model, n, nthread=1 if n == 1 else threads)

    def array(self, field: str) -> Array:
        """Live (n, ...) array of an `MjData` field: a state to read and write, or an output to read."""
        return np.asarray(self._batch.bind(field))

    def reset(self, ids: WorldIds | None = None) -> None:
        """Put worlds back into the first keyframe. Call `refresh` once the state is as it should be."""
        self._batch.reset(ids, keyframe=0, stage=mujoco.mjtStage.mjSTAGE_NONE.value)

    def refresh(self, ids: WorldIds | None = None) -> None:
        """Make the outputs agree with the state."""
        self._batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def step(self, substeps: int, ids: WorldIds | None = None) -> None:
        """Advance worlds by `substeps` time steps; outputs then agree with the new state."""
        self._batch.step(ids, nstep=substeps, stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def data(self, world: int) -> mujoco.MjData:
        """A copy of one world, for anything that MuJoCo can do with it."""
        data = self._batch.get_data(world)
        mujoco.mj_forward(self.model, data)
        return data
