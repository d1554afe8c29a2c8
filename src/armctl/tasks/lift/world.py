"""The MJCF of lift worlds: the table, a box on it, and fingers that grasp it."""

from typing import Any

import mujoco

from armctl.robot_description import ArmDescription
from armctl.robots.arm import PREFIX, add_collision_pair
from armctl.robots.hand import FINGERS, add_fingers, backs, pads
from armctl.simulation.contacts import add_contact_sensors
from armctl.tasks.tabletop.world import (
    NOMINAL_FRICTION,
    OBJECT,
    SLIDING,
    TABLE,
    add_forbidden_contacts,
    add_sliding_pair,
    add_table_and_object,
    let_links_touch,
    let_object_slide,
)

NOMINAL_HALF_SIZES = 0.025, 0.025, 0.025
"""m."""
TARGET_RADIUS = 0.1
"""m, of the disc that shows at which heights the object is lifted."""
GRIPPING = tuple(f"{OBJECT} on {pad}" for pad in pads())
RUBBING = SLIDING, *GRIPPING
"""Names of the contacts whose friction each episode draws."""
STIFF_FRICTION = 100.0
"""`impratio`: stiffness of friction relative to that of contacts. With 1, a box slides out of the hand slowly."""


def furnish(spec: Any, description: ArmDescription, memory: int) -> None:
    """Add table, object and moving fingers, and sensors of forbidden contacts over `memory` physics steps."""
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, STIFF_FRICTION
    target = spec.geom("target")
    target.type, target.size = mujoco.mjtGeom.mjGEOM_CYLINDER, [TARGET_RADIUS, TARGET_RADIUS, 0.0]
    add_table_and_object(spec, NOMINAL_HALF_SIZES)
    add_fingers(spec, description.name)
    let_links_touch(spec, description, apart=FINGERS)
    add_collision_pair(spec, OBJECT, "floor")
    for geom in (*pads(), *backs()):
        add_collision_pair(spec, geom, TABLE)
    for back in backs():
        add_collision_pair(spec, back, OBJECT)
    for pad, name in zip(pads(), GRIPPING, strict=True):
        add_sliding_pair(spec, pad, OBJECT, NOMINAL_FRICTION, name).condim = 4
    let_object_slide(spec)
    add_forbidden_contacts(spec, memory)
    fingers = {finger: (mujoco.mjtObj.mjOBJ_BODY, PREFIX + finger) for finger in FINGERS}
    add_contact_sensors(spec, fingers, {OBJECT: (mujoco.mjtObj.mjOBJ_GEOM, OBJECT)}, memory=1)
