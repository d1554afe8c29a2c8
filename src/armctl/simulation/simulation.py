"""n worlds of one MuJoCo model, stepped together on all cores."""

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

Array = NDArray[np.float64]
WorldIds = NDArray[np.int32]


class Simulation:
    """A thin wrapper of `mujoco.batch.Batch`; every world is bit-identical to one simulated alone.

    Worlds start in the first keyframe of `model`, if it has one.
    """

    def __init__(self, model: mujoco.MjModel, n: int, threads: int = 0) -> None:
        self.model, self.n = model, n
        self._batch = Batch(model, n, nthread=1 if n == 1 else threads)
        self._own: dict[str, Array] = {}

    def array(self, field: str) -> Array:
        """Live (n, ...) array of an `MjData` field: a state to read and write, or an output to read.

        Ask for outputs in a constructor: one that is asked for later holds zeros until the next `refresh` or `step`.
        """
        return np.asarray(self._batch.bind(field))

    def per_world(self, field: str) -> Array:
        """Live (n, ...) array of an `MjModel` field, which becomes separate for each world."""
        self._own[field] = np.asarray(self._batch.expand(field))
        return self._own[field]

    def derive(self, ids: WorldIds | None = None) -> None:
        """Recompute the model's constants from the masses, lengths and sizes of each world."""
        self._batch.set_const(ids)
        self._own = {field: values for field in MODEL_FIELDS if (values := self._batch.expanded(field)) is not None}

    @property
    def worlds_differ(self) -> bool:
        """Whether worlds have model fields of their own."""
        return bool(self._own)

    def reset(self, ids: WorldIds | None = None) -> None:
        """Reset worlds to the first keyframe, or the initial state. Call `refresh` after setting the state."""
        self._batch.reset(ids, keyframe=0 if self.model.nkey else -1, stage=mujoco.mjtStage.mjSTAGE_NONE.value)

    def refresh(self, ids: WorldIds | None = None) -> None:
        """Recompute the outputs from the state."""
        self._batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def step(self, substeps: int, ids: WorldIds | None = None) -> None:
        """Advance worlds by `substeps` time steps, with outputs of the new state."""
        self._batch.step(ids, nstep=substeps, stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def cast_rays(
        self, starts: Array, directions: Array, groups: NDArray[np.uint8], ids: WorldIds | None = None
    ) -> tuple[Array, NDArray[np.int32]]:
        """Distances in lengths of `directions`, and ids of the geoms of `groups` hit, (n, rays) each; -1 for a miss.

        Starts and directions broadcast to (n, rays, 3), where n is the number of worlds in `ids`, or of all.
        """
        distances, geoms = self._batch.ray(starts, directions, geomgroup=groups, ids=ids)
        return np.asarray(distances), np.asarray(geoms)

    def data(self, world: int) -> mujoco.MjData:
        """A copy of one world's data. As a side effect, `model` takes that world's own fields."""
        for field, values in self._own.items():
            getattr(self.model, field)[: len(values[world])] = values[
                world
            ]  # bvh_aabb: only the bodies' part is separate
        data = self._batch.get_data(world)
        mujoco.mj_forward(self.model, data)
        return data
