"""Boxes as Pinocchio's collision geometry."""

import coal
import pinocchio

from armctl.scene import Boxes


def add_boxes(geometry: pinocchio.GeometryModel, boxes: Boxes) -> None:
    """Add boxes to the geometry, and a collision pair of each box with every moving link."""
    capsules = [shape for shape in geometry.geometryObjects if isinstance(shape.geometry, coal.Capsule)]
    links = [geometry.getGeometryId(shape.name) for shape in capsules if shape.parentJoint > 0]
    for i, (centre, half_size, rotation) in enumerate(
        zip(boxes.centres, boxes.half_sizes, boxes.rotations, strict=True)
    ):
        placement = pinocchio.SE3(rotation, centre)
        shape = pinocchio.GeometryObject(f"(box {i})", 0, placement, coal.Box(*(2 * half_size)))
        box = geometry.addGeometryObject(shape)
        for link in links:
            geometry.addCollisionPair(pinocchio.CollisionPair(link, box))
