"""What is true: n worlds of one MuJoCo model, stepped at once, and pictures of them."""

from armctl.simulation.rendering import Camera
from armctl.simulation.simulation import Simulation

__all__ = ["Camera", "Simulation"]
