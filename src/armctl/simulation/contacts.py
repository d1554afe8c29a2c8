"""Which parts of a robot touch which classes of things, read from MuJoCo's contact sensors in all worlds at once."""

from collections.abc import Iterable, Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.simulation.simulation import Simulation

Thing = tuple[mujoco.mjtObj, str]
"""What touches or is touched: its kind, and its name."""

_HISTORY_HEAD = 2
"""Numbers before the sample times in a sensor's history buffer, which the samples follow."""


def add_contact_sensors(spec: Any, parts: Mapping[str, Thing], classes: Mapping[str, Thing], memory: int) -> None:
    """Give `spec` a sensor for each part and class, which remembers `memory` physics steps.

    Either is a geom (`mjOBJ_GEOM`), a body (`mjOBJ_BODY`) or all from a body on (`mjOBJ_XBODY`).
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
    """Reads what `add_contact_sensors` has added."""

    def __init__(self, simulation: Simulation, parts: Iterable[str], classes: Iterable[str]) -> None:
        model = simulation.model
        sensors = [[model.sensor(_sensor_name(part, label)) for label in classes] for part in parts]
        memory = int(model.sensor_history[sensors[0][0].id, 0])
        self._now = simulation.array("sensordata")
        self._history = simulation.array("history")
        self._columns = np.array([[sensor.adr[0] for sensor in row] for row in sensors])
        first = np.array([[model.sensor_historyadr[sensor.id] for sensor in row] for row in sensors])
        self._remembered = first[..., None] + _HISTORY_HEAD + memory + np.arange(memory)

    def now(self) -> NDArray[np.bool_]:
        """What touches now, (n, parts, classes)."""
        return self._now[:, self._columns] > 0

    def since_last_step(self) -> NDArray[np.bool_]:
        """What touches now, or did in one of the physics steps that the sensors remember, (n, parts, classes)."""
        return self.now() | (self._history[:, self._remembered] > 0).any(axis=-1)


def _sensor_name(part: str, label: str) -> str:
    return f"{part} on {label}"
