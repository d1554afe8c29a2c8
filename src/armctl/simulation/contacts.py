"""Contacts between parts of a robot and classes of objects, from MuJoCo's contact sensors in all worlds at once."""

from collections.abc import Iterable, Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.simulation.simulation import Simulation

Thing = tuple[mujoco.mjtObj, str]
"""A partner of a contact: its kind and its name."""

_HISTORY_HEAD = 2
"""Numbers before the sample times in a sensor's history buffer; the samples follow these."""


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
        memory = int(model.sensor_history[sensors[0][0].id, 0])
        self._now = simulation.array("sensordata")
        self._history = simulation.array("history")
        self._columns = np.array([[sensor.adr[0] for sensor in row] for row in sensors])
        first = np.array([[model.sensor_historyadr[sensor.id] for sensor in row] for row in sensors])
        self._samples = first[..., None] + _HISTORY_HEAD + memory + np.arange(memory)

    def now(self) -> NDArray[np.bool_]:
        """Current contacts, (n, parts, classes)."""
        return self._now[:, self._columns] > 0

    def since_last_step(self) -> NDArray[np.bool_]:
        """Contacts now or in one of the recorded physics steps, (n, parts, classes)."""
        return self.now() | (self._history[:, self._samples] > 0).any(axis=-1)


def _sensor_name(part: str, label: str) -> str:
    return f"{part} on {label}"
