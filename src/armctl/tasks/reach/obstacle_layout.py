"""What stands between an arm and its target: boxes, posts and sometimes a shelf, drawn anew for each episode.

Boxes and posts are strewn around the way that the end-effector would take from home to the target; a shelf has the
target between its boards. What would come too near to the arm at home, or to the target, is left out. Lengths grow with
the arm: those below are for one that reaches 1 m.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armctl.errors import ConfigurationError
from armctl.kinematics import Workspace
from armctl.scene import Boxes

Array = NDArray[np.float64]
Box = tuple[Array, Array, float]
"""Centre (3,), half sizes (3,) and yaw."""

MOST_BOXES, MOST_POSTS, SHELF_PARTS = 5, 3, 3
MOST_OBSTACLES = MOST_BOXES + MOST_POSTS + SHELF_PARTS
SHELVES = 0.3
"""Part of the layouts that have a shelf."""
HOME_MARGIN = 0.05
"""m from the arm at home."""
TARGET_MARGIN = 0.03
"""m from the sphere around the target."""
GOAL_MARGIN = 0.02
"""m that boxes are widened by for the arm at the target, which is to have room there."""
STREWN = 0.08
"""m, standard deviation of boxes around the end-effector's way."""
POST_THICKNESS = 0.03
"""m, half of it."""
BOARD = 0.01
"""m, half of its thickness."""


ATTEMPTS = 100


@dataclass(frozen=True, eq=False)
class ReachLayout:
    """What is new in an episode."""

    target: Array
    """(3,) m"""
    boxes: Boxes
    """At most `MOST_OBSTACLES`."""


def sample_layout(rng: np.random.Generator, workspace: Workspace, tolerance: float) -> ReachLayout:
    """Draw a target that the arm can be at, and what stands in its way from home; there may be no way.

    No box comes within `HOME_MARGIN` of the arm at home, or within `tolerance` and `TARGET_MARGIN` of the target.

    Raises `ConfigurationError` if nothing is found in `ATTEMPTS`.
    """
    for _ in range(ATTEMPTS):
        layout = _sample(rng, workspace, tolerance)
        wider = layout.boxes.half_sizes + GOAL_MARGIN
        among = workspace.model.among(Boxes(layout.boxes.centres, wider, layout.boxes.yaws))
        if any(among.is_free(q) for q in workspace.ik.free_configurations(layout.target)):
            return layout
    raise ConfigurationError(
        f"{ATTEMPTS} layouts, and none with room for {workspace.model.description.name} at its target"
    )


def _sample(rng: np.random.Generator, workspace: Workspace, tolerance: float) -> ReachLayout:
    model, scale = workspace.model, workspace.radius
    target = workspace.sample(rng, clearance=tolerance)
    start, goal = (_cylindrical(point - workspace.centre) for point in (model.position(model.home), target))
    around = (goal[1] - start[1] + math.pi) % (2 * math.pi) - math.pi
    way = np.array((goal[0] - start[0], around, goal[2] - start[2]))

    drawn = [_box(rng, workspace, start, way) for _ in range(rng.integers(3, MOST_BOXES + 1))]
    drawn += [_post(rng, workspace, start, way) for _ in range(rng.integers(1, MOST_POSTS + 1))]
    if rng.random() < SHELVES:
        drawn += _shelf(rng, workspace, target)
    boxes = Boxes(*(np.array(part, dtype=float) for part in zip(*drawn, strict=True)))
    apart = boxes.distances(target) >= tolerance + TARGET_MARGIN * scale
    apart &= model.box_distances(model.home, boxes) >= HOME_MARGIN * scale
    return ReachLayout(target, Boxes(boxes.centres[apart], boxes.half_sizes[apart], boxes.yaws[apart]))


def _box(rng: np.random.Generator, workspace: Workspace, start: Array, way: Array) -> Box:
    """A box somewhere along the end-effector's way, and on the floor or above it."""
    scale = workspace.radius
    half_size = scale * rng.uniform(0.03, 0.12, 3)
    centre = workspace.centre + _cartesian(start + rng.uniform(0.2, 0.9) * way)
    centre = centre + scale * STREWN * rng.normal(size=3)
    centre[2] = max(centre[2], half_size[2])
    return centre, half_size, rng.uniform(-math.pi, math.pi)


def _post(rng: np.random.Generator, workspace: Workspace, start: Array, way: Array) -> Box:
    """A post on the floor, in a direction that the arm turns through."""
    scale = workspace.radius
    radius, angle = scale * rng.uniform(0.35, 0.75), start[1] + rng.uniform(0.2, 0.9) * way[1]
    half_height = scale * rng.uniform(0.15, 0.45)
    centre = workspace.centre + _cartesian(np.array((radius, angle, 0.0)))
    centre[2] = half_height
    thickness = scale * POST_THICKNESS
    return centre, np.array((thickness, thickness, half_height)), rng.uniform(-math.pi, math.pi)


def _shelf(rng: np.random.Generator, workspace: Workspace, target: Array) -> list[Box]:
    """A board below the target, one above it and one behind it; the shelf opens roughly towards the arm."""
    scale = workspace.radius
    yaw = math.atan2(*(target - workspace.centre)[1::-1]) + rng.normal(0, 0.3)
    depth, width, below, above = scale * rng.uniform((0.1, 0.15, 0.1, 0.1), (0.15, 0.25, 0.2, 0.25))
    outward, up = np.array((math.cos(yaw), math.sin(yaw), 0.0)), np.array((0.0, 0.0, 1.0))
    board, half_height = scale * BOARD, (below + above) / 2
    middle = target + up * (above - below) / 2
    return [
        (target - up * below, np.array((depth, width, board)), yaw),
        (target + up * above, np.array((depth, width, board)), yaw),
        (middle + outward * depth, np.array((board, width, half_height)), yaw),
    ]


def _cylindrical(point: Array) -> Array:
    """Distance from the vertical axis, angle around it, height."""
    return np.array((math.hypot(point[0], point[1]), math.atan2(point[1], point[0]), point[2]))


def _cartesian(cylindrical: Array) -> Array:
    radius, angle, height = cylindrical
    return np.array((radius * math.cos(angle), radius * math.sin(angle), height))
