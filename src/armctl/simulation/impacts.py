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

from armctl.kernels.control_step import HardImpact
from armctl.simulation.history import sample_columns, state_column

FINER = 4
"""Finer steps in a physics step."""
DEEP = 0.002
"""m: a deeper penetration is a hard hit."""
FAST = 1.35
"""A joint that exceeds its speed limit by this factor has been hit hard; in finer steps, no joint is faster."""
BEYOND = 0.008
"""rad: so is a joint that far beyond its position limits."""
DEPTH = "depth of the deepest contact"


def add_impact_sensors(spec: Any, joints: Iterable[str], memory: int, body: str | None = None) -> None:
    """Add to `spec` the sensors that `hard_impact` looks at, with a history of `memory` physics steps.

    It takes joint names, and the name of the body that is hit; without one, all contacts are meant.
    """
    deepest = spec.add_sensor(name=DEPTH, type=mujoco.mjtSensor.mjSENS_CONTACT, nsample=memory)
    # of one contact: the one of least distance
    deepest.intprm = [1 << int(mujoco.mjtConDataField.mjCONDATA_DIST), 1, 1]
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


def hard_impact(model: mujoco.MjModel, speed_limits: Mapping[str, float]) -> HardImpact:
    """Return what is a hard impact on joints in `speed_limits` (rad/s), for a model with `add_impact_sensors` for them.

    It depends on the speeds of joints and the depth of contacts after each of the last steps, and joint positions.
    """
    joints = np.array([model.joint(name).id for name in speed_limits])
    dofs, limits = model.jnt_dofadr[joints], FAST * np.array(list(speed_limits.values()))
    depths = sample_columns(model, DEPTH)
    past = np.array([sample_columns(model, _speed(name)) for name in speed_limits])
    speeds = np.column_stack((past, state_column(model, mujoco.mjtState.mjSTATE_QVEL) + dofs))
    limited = joints[model.jnt_limited[joints].astype(bool)]
    positions = state_column(model, mujoco.mjtState.mjSTATE_QPOS) + model.jnt_qposadr[limited]
    lowest, highest = model.jnt_range[limited].T
    bounds = np.repeat(limits, speeds.shape[1])
    return HardImpact(
        columns=np.concatenate((depths, speeds.ravel(), positions)).astype(np.intp),
        lowest=np.concatenate((np.full(len(depths), -DEEP), -bounds, lowest - BEYOND)),
        highest=np.concatenate((np.full(len(depths), np.inf), bounds, highest + BEYOND)),
        depth=int(model.sensor(DEPTH).adr[0]),
        deepest=DEEP,
        steps=FINER,
        dofs=dofs.astype(np.intp),
        bounds=limits,
    )


def _speed(joint: str) -> str:
    return f"speed of {joint}"
