"""What is true: n worlds of one MuJoCo model, stepped at once, and what is touched and seen in them."""

from armctl.simulation.contacts import ContactSensors
from armctl.simulation.ray_camera import RayCamera
from armctl.simulation.rendering import Camera
from armctl.simulation.simulation import Simulation

__all__ = ["Camera", "ContactSensors", "RayCamera", "Simulation"]
