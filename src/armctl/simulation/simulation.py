"""n worlds of one MuJoCo model, stepped together on all cores.

MuJoCo resets a world whose numbers become infinite, in the middle of an episode. Here, that is switched off: such a
world stands still in its last good state, `unstable`, until it is reset. MuJoCo does not write its log file either.
"""

import copy
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kernels.control_step import Parts, Worlds
from armctl.simulation.control_step import NO_PARTS, Stepper
from armctl.simulation.impacts import hard_impact
from armctl.simulation.threads import usable_threads

_log = mujoco.MjLogConfig.get()
if _log.logfile == "MUJOCO_LOG.TXT":  # MuJoCo's default, in whichever folder the user is
    _log.logto_file = False
    _log.set()

WorldIds = NDArray[np.int32]

CURRENT = int(mujoco.mjtStage.mjSTAGE_VEL)
"""Stage at which positions, velocities and what depends on them are those of the new state after a step."""
_BAD = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)
"""MuJoCo's warnings of bad positions, velocities and accelerations."""


class Simulation:
    """A thin wrapper of `mujoco.batch.Batch`; every world is bit-identical to one simulated alone.

    Worlds start in the first keyframe of `model`, if it has one. As a side effect, `model` loses MuJoCo's automatic
    reset. With `speed_limits` of joints (rad/s, by name), impacts are simulated in finer steps: see `impacts`.
    """

    def __init__(
        self, model: mujoco.MjModel, n: int, threads: int = 0, speed_limits: Mapping[str, float] | None = None
    ) -> None:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        self.model, self.n = model, n
        self.nominal_model = model
        """The model without the fields that worlds have of their own, which pictures write into `model`."""
        self.unstable = np.zeros(n, dtype=bool)
        """(n,) worlds that have become unstable since their last reset: positions, velocities or accelerations were
        infinite, or no numbers."""
        self.threads = 1 if n == 1 else threads or usable_threads()
        """Threads to step the worlds on."""
        in_caches = n == 1 and speed_limits is None
        self._batch = Batch(model, n, nthread=self.threads, persistent=in_caches)
        self.refined = np.zeros(n, dtype=np.int32)
        """(n,) ticks of the last `control_step`, or 1 for `step`, that were made in finer steps, after an impact."""
        self._fields: dict[str, Array] = {}
        self._state = self._batch.state
        self._good = self._state.copy()
        self._stepper: Stepper | None = None
        if speed_limits is not None:
            worlds = Worlds(self._state, self._good, self.unstable, self.refined)
            self._stepper = Stepper(self._batch, self.threads, hard_impact(model, speed_limits), worlds, self._fields)
        self._warnings = self._batch.warning[:, _BAD, 1]
        self._motion = self.array("qpos"), self.array("qvel")
        self.any_unstable = False
        """Whether one of them is."""
        self._everywhere = np.arange(n, dtype=np.int32)

    def array(self, field: str) -> Array:
        """Return a live (n, ...) array of an `MjData` field: a state to read and write, or an output to read.

        Ask for outputs in a constructor: one that is asked for later holds zeros until the next `refresh` or `step`.
        """
        values = np.asarray(self._batch.bind(field))
        if self._stepper is not None and not np.may_share_memory(values, self._state):
            self._stepper.add_output(field, values)
        return values

    def per_world(self, field: str) -> Array:
        """Return a live (n, ...) array of an `MjModel` field, which becomes separate for each world."""
        self._keep_nominal_model()
        self._fields[field] = np.asarray(self._batch.expand(field))
        return self._fields[field]

    def field(self, name: str) -> Array:
        """Return an `MjModel` field of all worlds: (n, ...) where worlds have their own, otherwise (1, ...)."""
        values = self._fields.get(name)
        return np.asarray(getattr(self.model, name))[None] if values is None else values

    @property
    def live_arrays(self) -> Mapping[str, NDArray[Any]]:
        """All that determines how the worlds go on: MuJoCo's state, and the model's fields that each world has."""
        return {"state": self._state, "unstable": self.unstable, **self._fields}

    def derive(self, ids: WorldIds | None = None) -> None:
        """Recompute the model's constants from the masses, lengths and sizes of each world."""
        self._keep_nominal_model()
        self._batch.set_const(ids)
        fields = (field for field in MODEL_FIELDS if not field.startswith("opt."))
        self._fields.update((field, values) for field in fields if (values := self._batch.expanded(field)) is not None)

    def _keep_nominal_model(self) -> None:
        if self.nominal_model is self.model:
            self.nominal_model = copy.copy(self.model)

    @property
    def worlds_differ(self) -> bool:
        """True if worlds have model fields of their own."""
        return bool(self._fields)

    def reset(self, ids: WorldIds | None = None) -> None:
        """Reset worlds to the first keyframe, or the initial state. Call `refresh` after setting the state."""
        self._batch.reset(ids, keyframe=0 if self.model.nkey else -1, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        worlds = slice(None) if ids is None else ids
        self.unstable[worlds] = False
        self.any_unstable = bool(self.unstable.any())
        self._good[worlds] = self._state[worlds]

    def set_states(self, states: Array) -> None:
        """Put all worlds into one whole state (k,) of MuJoCo's, or each into its own, (n, k)."""
        self._state[:] = states
        self._good[:] = self._state
        self.unstable[:] = self.any_unstable = False
        self.refresh()

    def refresh(self, ids: WorldIds | None = None) -> None:
        """Recompute the outputs from the state."""
        self._batch.forward(ids, stage=CURRENT)

    def step(self, substeps: int, ids: WorldIds | None = None) -> None:
        """Advance worlds by `substeps` time steps, with outputs of the new state. Unstable worlds stand still."""
        if self._stepper is not None:
            self.control_step(1, substeps, ids)
            return
        self._batch.step(self._stable(ids), nstep=substeps, stage=CURRENT)
        self._stop_unstable()
        np.copyto(self._good, self._state)

    def control_step(self, ticks: int, substeps: int, ids: WorldIds | None = None, parts: Parts = NO_PARTS) -> None:
        """Advance worlds with `speed_limits` by `ticks` of `substeps` time steps each, as `step` does for one tick.

        Other `parts` than those of the last call take milliseconds more.
        """
        if self._stepper is None:
            raise ConfigurationError("control_step is for simulations with speed_limits of joints")
        stable = self._stable(ids)
        self._stepper.step(self._everywhere if stable is None else stable, ticks, substeps, parts)
        self.any_unstable = bool(np.count_nonzero(self.unstable))

    def _stable(self, ids: WorldIds | None) -> WorldIds | None:
        if not self.any_unstable:
            return ids
        requested = self._everywhere if ids is None else ids
        return requested[~self.unstable[requested]]

    def _stop_unstable(self) -> None:
        """Put worlds that have just become unstable back into their last good state."""
        good = all(np.abs(numbers).max(initial=0.0) < mujoco.mjMAXVAL for numbers in self._motion)
        if self._warnings.any() or not good:
            within = [(np.abs(numbers) < mujoco.mjMAXVAL).all(axis=1) for numbers in self._motion]
            bad = (self._warnings.any(axis=1) | ~np.logical_and(*within)) & ~self.unstable
            self.unstable |= bad
            self.any_unstable = bool(self.unstable.any())
            self._state[bad] = self._good[bad]
            self._batch.forward(np.flatnonzero(bad).astype(np.int32))

    def cast_rays(
        self, starts: Array, directions: Array, groups: NDArray[np.uint8], ids: WorldIds | None = None
    ) -> tuple[Array, NDArray[np.int32]]:
        """Return distances in lengths of `directions`, and ids of the geoms of `groups` hit, (n, rays); -1 for a miss.

        Starts and directions broadcast to (n, rays, 3), where n is the number of worlds in `ids`, or of all.
        """
        distances, geoms = self._batch.ray(starts, directions, geomgroup=groups, ids=ids)
        return np.asarray(distances), np.asarray(geoms)

    def data(self, world: int) -> mujoco.MjData:
        """Return a copy of one world's data. As a side effect, `model` takes that world's own fields."""
        for field, values in self._fields.items():
            # bvh_aabb: only the bodies' part is separate
            getattr(self.model, field)[: len(values[world])] = values[world]
        data = self._batch.get_data(world)
        mujoco.mj_forward(self.model, data)
        return data
