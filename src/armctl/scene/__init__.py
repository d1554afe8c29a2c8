"""Geometry shared by simulation and controllers: boxes, pedestrians, the map of a bridge."""

from armctl.scene.boxes import BOX_NUMBERS, NO_BOXES, TILTED_BOX_NUMBERS, Boxes
from armctl.scene.bridge_map import BridgeMap, EdgeTest
from armctl.scene.pedestrians import NO_PEDESTRIANS, PedestrianTrajectories

__all__ = [
    "BOX_NUMBERS", "NO_BOXES", "NO_PEDESTRIANS", "TILTED_BOX_NUMBERS", "Boxes", "BridgeMap", "EdgeTest",
    "PedestrianTrajectories",
]  # fmt: skip
