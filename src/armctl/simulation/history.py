"""Places in the state of a MuJoCo world, such as the last samples of a sensor."""

import mujoco
import numpy as np
from numpy.typing import NDArray

_HEAD = 2
"""Numbers before the sample times in a sensor's history buffer; the samples follow these."""
WHOLE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


def state_column(model: mujoco.MjModel, component: mujoco.mjtState) -> int:
    """Return the column of a world's state at which a component begins."""
    return int(mujoco.mj_stateSize(model, WHOLE & (int(component) - 1)))


def time_columns(model: mujoco.MjModel, sensor: str) -> NDArray[np.intp]:
    """Return the columns of the times (s) of a sensor's samples in the state, in no particular order."""
    index = model.sensor(sensor).id
    history = state_column(model, mujoco.mjtState.mjSTATE_HISTORY)
    return history + int(model.sensor_historyadr[index]) + _HEAD + np.arange(model.sensor_history[index, 0])


def sample_columns(model: mujoco.MjModel, sensor: str) -> NDArray[np.intp]:
    """Return the columns of these samples; the sensor is one of one number."""
    times = time_columns(model, sensor)
    return times + len(times)
