"""Loads arms in a process of its own: see `test_urdf.py`."""

import mujoco
import numpy as np
from child import serve

from armctl.kinematics import ArmModel
from armctl.robot_description import load_arm
from armctl.robots import build_arm_world


def check(path):
    arm = load_arm(path, tip="ee_link" if "ur5" in path.name else None)
    model, world = ArmModel(arm), build_arm_world(arm, "position")
    data = mujoco.MjData(world)
    mujoco.mj_resetDataKeyframe(world, data, 0)
    mujoco.mj_kinematics(world, data)
    tip, simulated = model.position(arm.home), data.body(f"arm/{arm.tip}").xpos
    assert np.isfinite(tip).all()
    assert np.isfinite(data.xpos).all()
    np.testing.assert_allclose(simulated, tip, rtol=1e-6, atol=1e-6)
    return f"{arm.dof} joints"


if __name__ == "__main__":
    serve(check)
