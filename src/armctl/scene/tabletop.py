"""The table of `armctl/ArmPush-v0` and `armctl/ArmLift-v0`: geometry that truth and belief share. SI units."""

import numpy as np

from armctl.scene.boxes import Boxes

TOP = 0.05
"""m: height of the table above the floor."""
TABLE_LOW, TABLE_HIGH = np.array((0.2, -0.45)), np.array((0.85, 0.45))
"""m: corners of the table top."""
MARGIN = 0.12
"""m: least distance of objects and targets from the table's edges."""


def table() -> Boxes:
    """Return the table as a box."""
    middle, half = (TABLE_LOW + TABLE_HIGH) / 2, (TABLE_HIGH - TABLE_LOW) / 2
    return Boxes(np.array([[*middle, TOP / 2]]), np.array([[*half, TOP / 2]]), np.zeros(1))
