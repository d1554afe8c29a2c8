"""The simulated truth: n worlds of one MuJoCo model, stepped together, with contact sensors and cameras."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.simulation.contacts import ContactSensors
    from armctl.simulation.ray_camera import RayCamera
    from armctl.simulation.rendering import Camera
    from armctl.simulation.simulation import Simulation

__all__ = ["Camera", "ContactSensors", "RayCamera", "Simulation"]

__getattr__, __dir__ = on_first_use(__name__)
