"""Control steps in compiled code: drives, physics, hard impacts and samples of worlds, some on each thread.

A control step has `ticks`. At the start of each, drives set the commands of motors, and bodies that move by themselves
are put in their places. In each, the same number of physics steps is made. MuJoCo's own batch makes these no slower,
but would have to be left and entered again at each tick. Unlike the batch, an error that MuJoCo itself holds to be
fatal, such as too little memory for a model's contacts, ends the process here.
"""

import ctypes
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from armctl.kernels import control_step as kernel
from armctl.kernels import mujoco_library
from armctl.kernels.compiling import Bound, bound
from armctl.kernels.control_step import (
    Clock,
    ContactOutput,
    Drives,
    HardImpact,
    Parts,
    PoseInput,
    Samples,
    StepBuffers,
    TargetQuery,
    Worlds,
)
from armctl.kernels.drives import DRIVE
from armctl.simulation.history import state_column

_BAD = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADQACC) + 1)
"""MuJoCo's warnings of bad positions, velocities and accelerations."""
CLOCK = ctypes.c_void_p.in_dll(ctypes.CDLL(mujoco_library.PATH), "mjcb_time")
"""MuJoCo's clock, for its statistics (`MjData.timer`). Its Python package sets one, and each stage of a step reads it
twice, which takes a tenth of a step: worlds here are stepped without."""
_NONE = np.zeros(0, dtype=np.intp)
_KINEMATIC = {
    *("xpos", "xquat", "xmat", "xipos", "ximat", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat"),
    *("cam_xpos", "cam_xmat", "sensordata"),
}
"""Outputs that depend on positions, velocities and contacts only, if that is true of the sensors."""
NO_PARTS = Parts(
    Drives(np.zeros(0, dtype=DRIVE), np.zeros((0, 0)), False, 0.0, _NONE),
    Samples(_NONE, np.zeros((0, 0, 0)), np.zeros((0, 0, 0))),
    TargetQuery(0, np.zeros((0, 0, 3)), -1.0, np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0, 3))),
    ContactOutput(_NONE.reshape(0, 0), _NONE.reshape(0, 0), np.zeros((0, 0), dtype=bool)),
    PoseInput(_NONE, np.zeros((0, 0, 0, 2)), np.zeros((0, 0, 3))),
)
"""Parts of worlds without drives, samples, targets, contacts, or bodies that move by themselves."""


class Stepper:
    """Steps the worlds of a batch on `threads` threads. `world_fields` are the model's fields that each world has."""

    def __init__(
        self, batch: Batch, threads: int, impact: HardImpact, worlds: Worlds, world_fields: dict[str, NDArray[Any]]
    ) -> None:
        self._batch, self._threads, self._impact, self._worlds = batch, threads, impact, worlds
        self._world_fields = world_fields
        self._outputs: dict[str, NDArray[Any]] = {}
        self._process = -1
        self._pool: ThreadPoolExecutor
        self._bound: list[Bound] = []
        self._kept: list[Any] = []
        self._bound_for: tuple[Any, ...] = ()
        self._time = state_column(batch.model, mujoco.mjtState.mjSTATE_TIME)

    def step(self, ids: NDArray[np.int32], ticks: int, substeps: int, parts: Parts = NO_PARTS) -> None:
        """Advance worlds `ids` by `ticks` of `substeps` physics steps each, with outputs of the new state."""
        if len(ids) < len(self._worlds.refined):
            self._worlds.refined[:] = 0
        arguments = self._bound_to(ticks, substeps, parts)[: max(1, len(ids))]
        clock, CLOCK.value = CLOCK.value, None
        try:
            self._run(ids, *arguments)
        finally:
            if clock:
                CLOCK.value = clock

    def _run(self, ids: NDArray[np.int32], first: Bound, *others: Bound) -> None:
        run: Callable[..., None] = kernel.control_steps
        if not others:
            run(ids, first)
            return
        shares = iter(_shares(ids, 1 + len(others)))

        def work(arguments: Bound) -> None:
            for share in shares:
                run(share, arguments)

        working = [self._threads_of_process().submit(work, arguments) for arguments in others]
        try:
            work(first)
        finally:
            wait(working)
        for future in working:
            future.result()

    def add_output(self, field: str, values: NDArray[Any]) -> None:
        """Fill `values` (n, ...) with a field of `MjData` from now on."""
        self._outputs[field] = values

    def _threads_of_process(self) -> ThreadPoolExecutor:
        """Return the other threads: a fork has none of its parent's."""
        if self._process != os.getpid():
            self._process, self._pool = os.getpid(), ThreadPoolExecutor(self._threads - 1)
        return self._pool

    def _bound_to(self, ticks: int, substeps: int, parts: Parts) -> list[Bound]:
        """Return the kernel's arguments on each thread."""
        bound_for = ticks, substeps, id(parts), len(self._world_fields), len(self._outputs)
        if bound_for != self._bound_for:
            clock = Clock(ticks, substeps, self._batch.model.opt.timestep, self._time)
            self._bound_for, self._kept = bound_for, [parts]
            self._bound = [
                bound((clock, self._make_buffers(), self._worlds, self._impact, parts)) for _ in range(self._threads)
            ]
        return self._bound

    def _make_buffers(self) -> StepBuffers:
        model, finer = self._batch.get_model(0), self._batch.get_model(0)
        finer.opt.timestep /= self._impact.steps
        data = mujoco.MjData(model)
        data.warning.number[:] = 1  # of those that have come before, MuJoCo prints nothing
        self._kept += [model, finer, data]
        rows = [
            (_address(values), values[0].nbytes, *(_address(_field(either, name)) for either in (model, finer)))
            for name, values in self._world_fields.items()
        ]
        outputs = [(_address(getattr(data, name)), out[0].nbytes, _address(out)) for name, out in self._outputs.items()]
        return StepBuffers(
            model=model._address,
            finer=finer._address,
            data=data._address,
            qpos=data.qpos,
            qvel=data.qvel,
            act=data.act,
            ctrl=data.ctrl,
            torques=data.qfrc_actuator,
            sensors=data.sensordata,
            positions=data.xpos,
            rotations=data.xmat,
            warnings=data.warning.number[_BAD],
            body_positions=(model.body_pos, finer.body_pos),
            world_fields=np.array(rows, dtype=np.intp).reshape(-1, 4),
            outputs=np.array(outputs, dtype=np.intp).reshape(-1, 3),
            kinematic=self._outputs.keys() <= _KINEMATIC and _has_kinematic_sensors(model),
            last_state=np.full(self._worlds.state.shape[1] if len(self._worlds.state) == 1 else 0, np.nan),
        )


def _shares(ids: NDArray[np.int32], threads: int) -> list[NDArray[np.int32]]:
    """Split worlds into smaller and smaller shares, of which threads that finish sooner take more.

    Each is an equal part of half of what is left (Polychronopoulos and Kuck, "Guided Self-Scheduling", IEEE Trans.
    Computers C-36(12), 1987).
    """
    shares, begin = [], 0
    while begin < len(ids):
        end = begin + max(1, (len(ids) - begin) // (2 * threads))
        shares.append(ids[begin:end])
        begin = end
    return shares


def _has_kinematic_sensors(model: mujoco.MjModel) -> bool:
    """Return whether all sensors are of kinds whose values depend on positions, velocities and contacts only."""
    kinds = (
        mujoco.mjtSensor.mjSENS_CONTACT, mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtSensor.mjSENS_JOINTVEL,
        mujoco.mjtSensor.mjSENS_GYRO,
    )  # fmt: skip
    without_forces = model.sensor_needstage < int(mujoco.mjtStage.mjSTAGE_ACC)
    return bool((without_forces & np.isin(model.sensor_type, [int(kind) for kind in kinds])).all())


def _field(model: mujoco.MjModel, name: str) -> NDArray[Any]:
    holder, _, field = name.rpartition(".")
    return np.asarray(getattr(model.opt if holder else model, field))


def _address(values: NDArray[Any]) -> int:
    return int(values.ctypes.data)
