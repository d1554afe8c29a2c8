"""n worlds of one MuJoCo model, stepped at once on all cores."""

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

Array = NDArray[np.float64]
WorldIds = NDArray[np.int32]


class Simulation:
    """A thin face over `mujoco.batch.Batch`; every world is bit-identical to one simulated alone.

    `model` has a keyframe, in which worlds start.
    """

    def __init__(self, model: mujoco.MjModel, n: int, threads: int = 0) -> None:
        self.model, self.n = model, n
        self._batch = Batch(model, n, nthread=1 if n == 1 else threads)
        self._own: dict[str, Array] = {}

    def array(self, field: str) -> Array:
        """Live (n, ...) array of an `MjData` field: a state to read and write, or an output to read."""
        return np.asarray(self._batch.bind(field))

    def per_world(self, field: str) -> Array:
        """Live (n, ...) array of an `MjModel` field, which worlds then have each for themselves."""
        self._own[field] = np.asarray(self._batch.expand(field))
        return self._own[field]

    def derive(self, ids: WorldIds | None = None) -> None:
        """Make the model's constants agree with masses, lengths and sizes that worlds have for themselves."""
        self._batch.set_const(ids)
        self._own = {field: values for field in MODEL_FIELDS if (values := self._batch.expanded(field)) is not None}

    @property
    def worlds_differ(self) -> bool:
        """Whether worlds have model fields each for themselves."""
        return bool(self._own)

    def reset(self, ids: WorldIds | None = None) -> None:
        """Put worlds back into the first keyframe. Call `refresh` once the state is as it should be."""
        self._batch.reset(ids, keyframe=0, stage=mujoco.mjtStage.mjSTAGE_NONE.value)

    def refresh(self, ids: WorldIds | None = None) -> None:
        """Make the outputs agree with the state."""
        self._batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def step(self, substeps: int, ids: WorldIds | None = None) -> None:
        """Advance worlds by `substeps` time steps; outputs then agree with the new state."""
        self._batch.step(ids, nstep=substeps, stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def cast_rays(
        self, starts: Array, directions: Array, groups: NDArray[np.uint8], ids: WorldIds | None = None
    ) -> tuple[Array, NDArray[np.int32]]:
        """Distances in lengths of `directions`, and ids of the geoms of `groups` hit, (n, rays) each; -1 for a miss.

        Starts and directions broadcast to (n, rays, 3), n being the number of worlds in `ids`, or of all.
        """
        distances, geoms = self._batch.ray(starts, directions, geomgroup=groups, ids=ids)
        return np.asarray(distances), np.asarray(geoms)

    def data(self, world: int) -> mujoco.MjData:
        """A copy of one world, for anything that MuJoCo can do with it and `model`, which is then that world's."""
        for field, values in self._own.items():
            getattr(self.model, field)[: len(values[world])] = values[world]  # of bvh_aabb, only bodies' are own
        data = self._batch.get_data(world)
        mujoco.mj_forward(self.model, data)
        return data
