"""The MJCF of push worlds: a straight tool, which pushes the object on the table."""

from typing import Any

import mujoco

from armctl.kinematics import ArmModel
from armctl.kinematics.vertical_tool import tool_axis
from armctl.robot_description import ArmDescription
from armctl.robots.arm import PREFIX, add_collision_pair
from armctl.scene import push_table, tabletop
from armctl.tasks.tabletop.world import (
    OBJECT,
    TABLE,
    add_forbidden_contacts,
    add_sliding_pair,
    add_table_and_object,
    let_links_touch,
    let_object_slide,
)

TOOL = "tool"
TOOL_FRICTION = 0.4
"""Coefficient of friction between tool and object."""


def furnish(spec: Any, description: ArmDescription, memory: int) -> None:
    """Add table, object and tool, and sensors of forbidden contacts over `memory` physics steps."""
    target = spec.geom("target")
    target.pos = [0.0, 0.0, tabletop.TOP - push_table.TOOL_HEIGHT + 0.002]  # above the table top
    target.type, target.size = mujoco.mjtGeom.mjGEOM_CYLINDER, [0.05, 0.001, 0.0]
    add_table_and_object(spec, push_table.OBJECT_HALF_SIZES)
    axis = tool_axis(ArmModel(description))
    tool = spec.body(PREFIX + description.tip).add_body(name=TOOL, pos=push_table.TOOL_LENGTH * axis)
    tool.gravcomp = 1.0
    tool.add_geom(
        name=TOOL,
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        size=[push_table.TOOL_RADIUS, 0, 0],
        fromto=[*(-push_table.TOOL_LENGTH * axis), *(-push_table.TOOL_RADIUS * axis)],
        material="aluminium",
        contype=0,
        conaffinity=0,
        mass=0,
    )
    let_links_touch(spec, description)
    add_collision_pair(spec, TOOL, TABLE)
    add_collision_pair(spec, TOOL, "floor")
    add_collision_pair(spec, OBJECT, "floor")
    add_sliding_pair(spec, TOOL, OBJECT, TOOL_FRICTION)
    let_object_slide(spec)
    add_forbidden_contacts(spec, memory)
