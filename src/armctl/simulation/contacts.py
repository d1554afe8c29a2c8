"""Contacts between parts of a robot and classes of objects, from MuJoCo's contact sensors in all worlds at once."""

from collections.abc import Iterable, Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.kernels.control_step import ContactOutput
from armctl.simulation.history import sample_columns, time_columns
from armctl.simulation.simulation import Simulation, WorldIds

Thing = tuple[mujoco.mjtObj, str]
"""A partner of a contact: its kind and its name."""


def add_contact_sensors(spec: Any, parts: Mapping[str, Thing], classes: Mapping[str, Thing], memory: int) -> None:
    """Add to `spec` a sensor for each part and class, with a history of `memory` physics steps.

    Both are geoms (`mjOBJ_GEOM`), bodies (`mjOBJ_BODY`) or subtrees of bodies (`mjOBJ_XBODY`).
    """
    for part, (part_kind, part_name) in parts.items():
        for label, (kind, name) in classes.items():
            sensor = spec.add_sensor(
                name=_sensor_name(part, label),
                type=mujoco.mjtSensor.mjSENS_CONTACT,
                objtype=part_kind,
                objname=part_name,
                reftype=kind,
                refname=name,
            )
            sensor.intprm = [1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1]
            sensor.nsample = memory


class ContactSensors:
    """Reads the sensors of `add_contact_sensors`."""

    def __init__(self, simulation: Simulation, parts: Iterable[str], classes: Iterable[str]) -> None:
        model = simulation.model
        sensors = [[model.sensor(_sensor_name(part, label)) for label in classes] for part in parts]
        self._touched = np.zeros((simulation.n, len(sensors), len(sensors[0])), dtype=bool)
        self._current, self._state = simulation.array("sensordata"), simulation.live_arrays["state"]
        self._columns = np.array([[sensor.adr[0] for sensor in row] for row in sensors])
        self._samples = np.array([[sample_columns(model, sensor.name) for sensor in row] for row in sensors])
        times = np.array([[time_columns(model, sensor.name) for sensor in row] for row in sensors])
        sensor_count, memory = times[..., 0].size, times.shape[-1]
        self.part = ContactOutput(
            self._samples.reshape(sensor_count, memory), times.reshape(sensor_count, memory),
            self._touched.reshape(simulation.n, sensor_count),
        )  # fmt: skip
        """What `Simulation.control_step` notes: contacts in finer steps, which are too many to be recorded."""

    def current(self) -> NDArray[np.bool_]:
        """Return current contacts, (n, parts, classes)."""
        return self._current[:, self._columns] > 0

    def since_last_step(self) -> NDArray[np.bool_]:
        """Return contacts at present, in one of the recorded physics steps, or in finer ones, (n, parts, classes)."""
        return self.current() | (self._state[:, self._samples] > 0).any(axis=-1) | self._touched

    def forget(self, ids: WorldIds | None) -> None:
        """Forget what was noted in worlds `ids`, or in all: a control step or an episode begins."""
        self._touched[slice(None) if ids is None else ids] = False


def _sensor_name(part: str, label: str) -> str:
    return f"{part} on {label}"
