"""The object on the table of `armctl/ArmPush-v0`, and the tool: geometry that truth and belief share. SI units."""

import numpy as np

from armctl.core.arrays import Array
from armctl.scene.tabletop import TOP

OBJECT_HALF_SIZES = np.array((0.05, 0.04, 0.03))
"""m, of the box that is pushed."""
OBJECT_RADIUS = float(np.linalg.norm(OBJECT_HALF_SIZES[:2]))
"""m, of the circle around the box."""
TOOL_LENGTH, TOOL_RADIUS = 0.15, 0.012
"""m, of the straight tool with a round end."""
TOOL_HEIGHT = TOP + OBJECT_HALF_SIZES[2]
"""m: height of the tool's end while it pushes."""
LIFTED_HEIGHT = TOP + 2 * OBJECT_HALF_SIZES[2] + 0.05
"""m: height at which it passes over the object."""
STAND_OFF = OBJECT_RADIUS + TOOL_RADIUS + 0.02
"""m: distance from the object's centre at which the tool comes down behind it."""
SPACING = 0.03
"""m between the points of a certified line."""


def line_points(place: Array, target: Array) -> Array:
    """Return where the tool ends (k, 3) that pushes an object from `place` (2,) along a line to `target` (2,).

    It comes down behind the object, goes on until the object is at the target, whichever side it is pushed on, and goes
    back lifted: it can begin again from anywhere on the line.
    """
    offset = target - place
    distance = float(np.linalg.norm(offset))
    way = offset / distance
    steps = np.linspace(
        -STAND_OFF, distance - TOOL_RADIUS - OBJECT_HALF_SIZES[1], 2 + int((distance + STAND_OFF) / SPACING)
    )
    points = np.column_stack((place + steps[:, None] * way, np.full(len(steps), TOOL_HEIGHT)))
    lifted = np.column_stack((points[:, :2], np.full(len(points), LIFTED_HEIGHT)))
    return np.vstack((lifted[:1], points, lifted[::-1]))
