"""Impacts in finer physics steps, with a bound on the speed of joints.

At the speed of an arm, a link is a centimetre deep in the floor before a physics step of 2 ms sees it there, and what
throws it out again spins a light wrist at ten times its speed limit. So the steps in which something is hit hard are
taken back, and repeated in finer ones. In these, joint speeds are bounded after each step, as PhysX does
(`maxJointVelocity`): it stands for rotor, gearbox and brake of a drive, which take up a blow. Everything else stays as
it is, bit for bit.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from armctl.kernels.physics import clip_speeds, mark_unusual
from armctl.simulation.history import sample_columns

Array = NDArray[np.float64]
WorldIds = NDArray[np.int32]

FINER = 4
"""Finer steps in a physics step."""
DEEP = 0.002
"""m: a deeper penetration is a hard hit."""
FAST = 1.35
"""A joint that exceeds its speed limit by this factor has been hit hard; in finer steps, no joint is faster."""
BEYOND = 0.008
"""rad: so is a joint that far beyond its position limits."""
CURRENT = int(mujoco.mjtStage.mjSTAGE_VEL)
"""With it, positions, velocities and what depends on them are those of the new state after a step."""
DEPTH = "depth of the deepest contact"


def add_impact_sensors(spec: Any, joints: Iterable[str], memory: int, body: str | None = None) -> None:
    """Add to `spec` the sensors that `Impacts` needs, with a history of `memory` physics steps.

    It takes joint names, and the name of the body that is hit; without one, all contacts are meant.
    """
    deepest = spec.add_sensor(name=DEPTH, type=mujoco.mjtSensor.mjSENS_CONTACT, nsample=memory)
    deepest.intprm = [
        1 << int(mujoco.mjtConDataField.mjCONDATA_DIST),
        1,
        1,
    ]  # of one contact: the one of least distance
    if body is not None:
        deepest.objtype, deepest.objname = mujoco.mjtObj.mjOBJ_BODY, body
    for joint in joints:
        spec.add_sensor(
            name=_speed(joint),
            type=mujoco.mjtSensor.mjSENS_JOINTVEL,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint,
            nsample=memory,
        )


class Impacts:
    """Steps a batch whose model has the sensors of `add_impact_sensors`, for the joints in `speed_limits` (rad/s).

    It makes `substeps` at a time, at most as many as the sensors remember.
    """

    def __init__(self, batch: Batch, speed_limits: Mapping[str, float]) -> None:
        model, self._batch = batch.model, batch
        joints = [model.joint(name).id for name in speed_limits]
        self._dofs, self._bounds = model.jnt_dofadr[joints], FAST * np.array(list(speed_limits.values()))
        self.refined = np.zeros(batch.nsim, dtype=bool)
        """(n,) worlds whose last step was repeated in finer ones."""
        self._state, self._before, self._qvel = batch.state, batch.state.copy(), np.asarray(batch.bind("qvel"))
        self._depths = np.asarray(batch.bind("sensordata"))[:, model.sensor(DEPTH).adr[0]]
        self._watched, self._lowest, self._highest = self._usual_ranges(joints, list(speed_limits))
        self._timestep = np.asarray(batch.expand("opt.timestep"))

    def step(self, substeps: int, ids: WorldIds | None) -> bool:
        """Advance worlds by `substeps` time steps, with outputs of the new state. Return whether all went as usual."""
        np.copyto(self._before, self._state)
        self._batch.step(ids, nstep=substeps, stage=CURRENT)
        hit = self.refined
        if not mark_unusual(self._state, self._watched, self._lowest, self._highest, self._depths, DEEP, hit):
            return True
        worlds = np.flatnonzero(hit).astype(np.int32) if ids is None else ids[hit[ids]]
        hit[:] = False
        hit[worlds] = True
        if len(worlds):
            self._state[worlds], self._batch.warning[worlds] = self._before[worlds], 0
            self._step_finely(substeps * FINER, worlds)
        return False

    def _step_finely(self, steps: int, worlds: WorldIds) -> None:
        self._timestep[worlds] /= FINER
        for _ in range(steps):
            self._batch.step(worlds)
            clip_speeds(self._qvel, worlds, self._dofs, self._bounds)
        self._timestep[worlds] *= FINER
        self._batch.forward(worlds)  # all stages: torques, which a lower one leaves out, would be another world's

    def _usual_ranges(self, joints: list[int], names: list[str]) -> tuple[NDArray[np.intp], Array, Array]:
        """Columns of the state, and between which numbers they are, unless something was hit hard.

        These are the speeds of joints and the depth of contacts, after each of the last steps, and joint positions.
        """
        model = self._batch.model
        history, qvel, qpos = (self._first_column(name) for name in ("history", "qvel", "qpos"))
        depths = history + sample_columns(model, DEPTH)
        past = np.array([history + sample_columns(model, _speed(name)) for name in names])
        speeds = np.column_stack((past, qvel + self._dofs))
        limited = [joint for joint in joints if model.jnt_limited[joint]]
        positions = qpos + model.jnt_qposadr[limited]
        lowest, highest = model.jnt_range[limited].T
        bounds = np.repeat(self._bounds, speeds.shape[1])
        columns = np.concatenate((depths, speeds.ravel(), positions))
        return (
            columns.astype(np.intp),
            np.concatenate((np.full(len(depths), -DEEP), -bounds, lowest - BEYOND)),
            np.concatenate((np.full(len(depths), np.inf), bounds, highest + BEYOND)),
        )

    def _first_column(self, field: str) -> int:
        """The column of the state at which a field begins."""
        state, values = self._batch.state, np.asarray(self._batch.bind(field))
        return int((values.ctypes.data - state.ctypes.data) // state.itemsize)


def _speed(joint: str) -> str:
    return f"speed of {joint}"
