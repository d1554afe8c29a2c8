"""The MJCF of worlds with a table: the table and an object on it beside the arm, and contacts."""

from collections.abc import Collection
from typing import Any

import mujoco

from armctl.robot_description import ArmDescription
from armctl.robot_description.collision_pairs import FLOOR
from armctl.robots.arm import HARD, PREFIX, add_collision_pair, collision_geom
from armctl.scene import tabletop
from armctl.simulation.contacts import Thing, add_contact_sensors

OBJECT, TABLE = "object", "table"
SLIDING = "object on table"
"""Name of a contact whose friction each episode draws."""
TOUCHED = "floor", TABLE, "itself"
"""Names of what the arm must not touch."""
CAMERA = (1.45, -1.25, 1.15), (0.763, 0.646, 0.0, -0.711, 0.839, 1.703)
"""Its position (m, for an arm with a reach of 1 m) and axes: all of the table is in the picture."""
WOOD = (0.72, 0.6, 0.45, 1.0)
NOMINAL_FRICTION, NOMINAL_MASS = 0.4, 0.5


def add_table_and_object(spec: Any, half_sizes: Any) -> None:
    """Add the table, and a box with these half sizes (3,) m on it."""
    spec.camera("overview").pos, spec.camera("overview").alt.xyaxes = CAMERA
    board = tabletop.table()
    _add_box(spec.worldbody, TABLE, board.half_sizes[0], rgba=WOOD, pos=board.centres[0])
    body = spec.worldbody.add_body(name=OBJECT, pos=[*board.centres[0, :2], tabletop.TOP + half_sizes[2]])
    body.add_freejoint(name=OBJECT)
    _add_box(body, OBJECT, half_sizes, material="obstacle", mass=NOMINAL_MASS)


def let_links_touch(spec: Any, description: ArmDescription, apart: Collection[str] = ()) -> None:
    """Let the links that may touch the floor, except those of `apart`, touch table and object."""
    for first, second in description.collision_pairs:
        link = second if first == FLOOR else first
        if FLOOR in (first, second) and link not in apart:
            add_collision_pair(spec, collision_geom(link), TABLE)
            add_collision_pair(spec, collision_geom(link), OBJECT)


def add_sliding_pair(spec: Any, first: str, second: str, friction: float, name: str = "") -> Any:
    """Let two geoms touch with a coefficient of friction, and return the pair."""
    return spec.add_pair(
        name=name, geomname1=first, geomname2=second, condim=3, solref=HARD[0], solimp=HARD[1],
        friction=[friction, friction, 0.005, 0.0001, 0.0001],
    )  # fmt: skip


def let_object_slide(spec: Any) -> None:
    """Let the object slide on the table."""
    add_sliding_pair(spec, OBJECT, TABLE, NOMINAL_FRICTION, SLIDING)


def add_forbidden_contacts(spec: Any, memory: int) -> None:
    """Add sensors of contacts of the arm with floor, table and itself, over `memory` physics steps."""
    root = next(body for body in spec.worldbody.bodies if body.name.startswith(PREFIX)).name
    arm: Thing = mujoco.mjtObj.mjOBJ_XBODY, root
    geoms = ((mujoco.mjtObj.mjOBJ_GEOM, name) for name in TOUCHED[:2])
    add_contact_sensors(spec, {"arm": arm}, dict(zip(TOUCHED, (*geoms, arm), strict=True)), memory)


def _add_box(body: Any, name: str, half_sizes: Any, **values: Any) -> None:
    body.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half_sizes, contype=0, conaffinity=0, **values
    )  # fmt: skip
