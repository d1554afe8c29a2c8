"""The simulated truth: n worlds of one MuJoCo model, stepped together, with contact sensors and cameras."""

import mujoco

from armctl.simulation.contacts import ContactSensors
from armctl.simulation.ray_camera import RayCamera
from armctl.simulation.rendering import Camera
from armctl.simulation.simulation import Simulation

_log = mujoco.MjLogConfig.get()
if _log.logfile == "MUJOCO_LOG.TXT":  # MuJoCo's default, in whichever folder the user is
    _log.logto_file = False
    _log.set()

__all__ = ["Camera", "ContactSensors", "RayCamera", "Simulation"]
