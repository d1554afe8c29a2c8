"""The MJCF of push worlds: table, object and tool beside the arm, and the contacts among them."""

from typing import Any

import mujoco

from armctl.kinematics import ArmModel
from armctl.kinematics.vertical_tool import tool_axis
from armctl.robot_description import ArmDescription
from armctl.robot_description.collision_pairs import FLOOR
from armctl.robots.arm import HARD, PREFIX, add_collision_pair, collision_geom
from armctl.scene import push_table
from armctl.simulation.contacts import add_contact_sensors

OBJECT, TABLE, TOOL = "object", "table", "tool"
SLIDING = "object on table"
"""Name of the contact whose friction each episode draws."""
TOUCHED = "floor", TABLE, "itself"
"""Names of what the arm must not touch."""
CAMERA = (1.45, -1.25, 1.15), (0.763, 0.646, 0.0, -0.711, 0.839, 1.703)
"""Its position (m, for an arm with a reach of 1 m) and axes: all of the table is in the picture."""
WOOD = (0.72, 0.6, 0.45, 1.0)
TOOL_FRICTION = 0.4
"""Coefficient of friction between tool and object."""
NOMINAL_FRICTION, NOMINAL_MASS = 0.4, 0.5


def furnish(spec: Any, description: ArmDescription, memory: int) -> None:
    """Add table, object and tool, and sensors of forbidden contacts over `memory` physics steps."""
    spec.camera("overview").pos, spec.camera("overview").alt.xyaxes = CAMERA
    target = spec.geom("target")
    target.pos = [0.0, 0.0, push_table.TOP - push_table.TOOL_HEIGHT + 0.002]  # above the table top
    target.type, target.size = mujoco.mjtGeom.mjGEOM_CYLINDER, [0.05, 0.001, 0.0]
    board = push_table.table()
    _add_box(spec.worldbody, TABLE, board.half_sizes[0], rgba=WOOD, pos=board.centres[0])
    pushed = spec.worldbody.add_body(name=OBJECT, pos=[*board.centres[0, :2], push_table.TOOL_HEIGHT])
    pushed.add_freejoint(name=OBJECT)
    _add_box(pushed, OBJECT, push_table.OBJECT_HALF_SIZES, material="obstacle", mass=NOMINAL_MASS)
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
    for first, second in description.collision_pairs:
        if FLOOR in (first, second):
            link = collision_geom(second if first == FLOOR else first)
            add_collision_pair(spec, link, TABLE)
            add_collision_pair(spec, link, OBJECT)
    add_collision_pair(spec, TOOL, TABLE)
    add_collision_pair(spec, TOOL, "floor")
    add_collision_pair(spec, OBJECT, "floor")
    _add_sliding_pair(spec, TOOL, OBJECT, TOOL_FRICTION)
    _add_sliding_pair(spec, OBJECT, TABLE, NOMINAL_FRICTION, SLIDING)
    root = next(body for body in spec.worldbody.bodies if body.name.startswith(PREFIX)).name
    arm = mujoco.mjtObj.mjOBJ_XBODY, root
    geoms = ((mujoco.mjtObj.mjOBJ_GEOM, name) for name in TOUCHED[:2])
    add_contact_sensors(spec, {"arm": arm}, dict(zip(TOUCHED, (*geoms, arm), strict=True)), memory)


def _add_box(body: Any, name: str, half_sizes: Any, **values: Any) -> None:
    body.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half_sizes, contype=0, conaffinity=0, **values
    )  # fmt: skip


def _add_sliding_pair(spec: Any, first: str, second: str, friction: float, name: str = "") -> None:
    spec.add_pair(
        name=name, geomname1=first, geomname2=second, condim=3, solref=HARD[0], solimp=HARD[1],
        friction=[friction, friction, 0.005, 0.0001, 0.0001],
    )  # fmt: skip
