"""Where MuJoCo keeps the last samples of a sensor."""

import mujoco
import numpy as np
from numpy.typing import NDArray

_HEAD = 2
"""Numbers before the sample times in a sensor's history buffer; the samples follow these."""


def time_columns(model: mujoco.MjModel, sensor: str) -> NDArray[np.intp]:
    """Columns of the times (s) of the samples of a sensor in `MjData.history`, in no particular order."""
    index = model.sensor(sensor).id
    return int(model.sensor_historyadr[index]) + _HEAD + np.arange(model.sensor_history[index, 0])


def sample_columns(model: mujoco.MjModel, sensor: str) -> NDArray[np.intp]:
    """Columns of these samples; the sensor is one of one number."""
    times = time_columns(model, sensor)
    return times + len(times)
