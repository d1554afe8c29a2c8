"""Grasps of boxes on a table from above, by fingers that close along the end-effector's y axis."""

import itertools

import numpy as np

from armctl.core.arrays import Array
from armctl.kinematics.vertical_tool import VerticalTool
from armctl.scene import lift_table

SPACING = np.array((0.03, 0.03, 0.03, 0.1))
"""m, m, m and rad between the points of a path."""


def grasp_turn(tool: VerticalTool, place: Array, yaw: float) -> float:
    """Return the turn (rad) that aligns the fingers with a box at a place (2,) m: the one of four that moves least.

    `yaw` (rad) is that of the box.
    """
    neutral, quarter = tool.turn(place), np.pi / 2
    closing = tool.pose(np.append(place, lift_table.GRASP_HEIGHT), neutral)[:2, 1]
    return float(neutral + (yaw - np.arctan2(closing[1], closing[0]) + quarter / 2) % quarter - quarter / 2)


def hand_turn(tool: VerticalTool, closing: Array) -> float:
    """Return the turn (rad) since home of a hand that closes along `closing` (3,), -pi to pi."""
    home = tool.pose(tool.point(tool.model.home), 0.0)[:2, 1]
    turn = np.arctan2(closing[1], closing[0]) - np.arctan2(home[1], home[0])
    return float((turn + np.pi) % (2 * np.pi) - np.pi)


def grasp_path(tool: VerticalTool, place: Array, yaw: float, height: float) -> tuple[Array, Array]:
    """Return points (k, 3) and turns (k,) from home over a box at a place (2,) m, down to it, and up to `height`."""
    turn, heights = grasp_turn(tool, place, yaw), (lift_table.APPROACH_HEIGHT, lift_table.GRASP_HEIGHT, height)
    corners = [np.append(tool.point(tool.model.home), 0.0), *(np.array((*place, z, turn)) for z in heights)]
    parts = [
        np.linspace(start, end, 2 + int((np.abs(end - start) / SPACING).max()))
        for start, end in itertools.pairwise(corners)
    ]
    path = np.vstack(parts)
    return path[:, :3], path[:, 3]
