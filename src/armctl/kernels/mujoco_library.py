"""Functions of MuJoCo's library for kernels, which take addresses of models, data and arrays."""

from pathlib import Path

import llvmlite.binding
import mujoco
from numba import types

PATH = str(next(path for name in ("libmujoco.*", "mujoco.dll") for path in Path(mujoco.__file__).parent.glob(name)))
llvmlite.binding.load_library_permanently(PATH)


def _of_model_and_data(name: str) -> types.ExternalFunction:
    return types.ExternalFunction(name, types.void(types.intp, types.intp))


step, forward = _of_model_and_data("mj_step"), _of_model_and_data("mj_forward")
begin_step, end_step = _of_model_and_data("mj_step1"), _of_model_and_data("mj_step2")
kinematics, collide = _of_model_and_data("mj_fwdKinematics"), _of_model_and_data("mj_collision")
body_velocities, actuate = _of_model_and_data("mj_comVel"), _of_model_and_data("mj_fwdActuation")
sense_positions, sense_velocities = _of_model_and_data("mj_sensorPos"), _of_model_and_data("mj_sensorVel")
get_state = types.ExternalFunction("mj_getState", types.void(types.intp, types.intp, types.intp, types.int32))
set_state = types.ExternalFunction("mj_setState", types.void(types.intp, types.intp, types.intp, types.int32))
copy = types.ExternalFunction("memcpy", types.intp(types.intp, types.intp, types.intp))
compare = types.ExternalFunction("memcmp", types.int32(types.intp, types.intp, types.intp))
