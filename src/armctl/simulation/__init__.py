"""The simulated truth: n worlds of one MuJoCo model, stepped together, with contact sensors and cameras."""

from armctl.simulation.contacts import ContactSensors
from armctl.simulation.ray_camera import RayCamera
from armctl.simulation.rendering import Camera
from armctl.simulation.simulation import Simulation

__all__ = ["Camera", "ContactSensors", "RayCamera", "Simulation"]
