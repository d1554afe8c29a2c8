"""Samples obstacles between an arm and its target for each episode: boxes, posts and sometimes a shelf.

Boxes and posts are placed at random around the path of the end-effector from home to the target; a shelf has the target
between its boards. Obstacles too close to the arm at home or to the target are left out. All lengths scale with the
arm: those below are for an arm with a reach of 1 m.
"""

import math
from dataclasses import dataclass

import numpy as np

from armctl import planning
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kinematics import Workspace
from armctl.scene import Boxes

Box = tuple[Array, Array, float]
"""Centre (3,), half sizes (3,) and yaw."""

MAX_BOXES, MAX_POSTS, SHELF_PARTS = 5, 3, 3
MAX_OBSTACLES = MAX_BOXES + MAX_POSTS + SHELF_PARTS
SHELVES = 0.3
"""Probability that a layout has a shelf."""
HOME_MARGIN = 0.05
"""m, least distance of obstacles from the arm at home."""
TARGET_MARGIN = 0.03
"""m, least distance of obstacles from the sphere around the target."""
GOAL_MARGIN = 0.02
"""m by which boxes are enlarged when it is checked that the arm has room at the target."""
SPREAD = 0.08
"""m, standard deviation of boxes around the end-effector's path."""
POST_HALF_WIDTH = 0.03
"""m"""
BOARD_HALF_THICKNESS = 0.01
"""m"""
ATTEMPTS = 100
"""Layouts that are tried, at most."""
CERTIFIED_ATTEMPTS = 50
"""Layouts that are tried until one is certified to have a path, at most."""


@dataclass(frozen=True, eq=False)
class ReachLayout:
    """The random part of an episode."""

    target: Array
    """(3,) m"""
    boxes: Boxes
    """Boxes, at most `MAX_OBSTACLES`."""


def sample_layout(rng: np.random.Generator, workspace: Workspace, tolerance: float) -> ReachLayout:
    """Sample a target that the arm can reach, and obstacles between home and target. There may be no free path.

    No box comes within `HOME_MARGIN` of the arm at home, or within `tolerance` + `TARGET_MARGIN` of the target.

    Raises `ConfigurationError` if nothing is found in `ATTEMPTS`.
    """
    for _ in range(ATTEMPTS):
        layout = _sample(rng, workspace, tolerance)
        wider = layout.boxes.half_sizes + GOAL_MARGIN
        among = workspace.model.among(Boxes(layout.boxes.centres, wider, layout.boxes.yaws))
        if any(among.is_free(q) for q in workspace.ik.free_configurations(layout.target)):
            return layout
    raise ConfigurationError(f"none of {ATTEMPTS} layouts leaves {workspace.model.description.name} room at its target")


def sample_certified_layout(
    rng: np.random.Generator,
    workspace: Workspace,
    certificate: "planning.PathCertificate",
    tolerance: float,
    solvable: bool,
) -> tuple[ReachLayout, bool]:
    """Sample a layout, rounded as it is observed, and whether it is certified to have a path.

    If `solvable`, layouts are sampled until one is certified. Raises `ConfigurationError` if none is in
    `CERTIFIED_ATTEMPTS`.
    """
    home = _as_observed(workspace.model.home)
    for _ in range(CERTIFIED_ATTEMPTS):
        sampled = sample_layout(rng, workspace, tolerance)
        numbers = _as_observed(sampled.boxes.numbers)
        layout = ReachLayout(_as_observed(sampled.target), Boxes(numbers[:, :3], numbers[:, 3:6], numbers[:, 6]))
        feasible = len(certificate.path(home, layout.target, layout.boxes)) > 0
        if feasible or not solvable:
            return layout, feasible
    raise ConfigurationError(f"none of {CERTIFIED_ATTEMPTS} layouts is certified to have a path")


def _as_observed(numbers: Array) -> Array:
    """Round numbers as in an observation, so that a policy plans on exactly the problem that was certified."""
    return numbers.astype(np.float32).astype(float)


def _sample(rng: np.random.Generator, workspace: Workspace, tolerance: float) -> ReachLayout:
    model, scale = workspace.model, workspace.radius
    target = workspace.sample(rng, clearance=tolerance)
    start, goal = (_cylindrical(point - workspace.centre) for point in (model.position(model.home), target))
    around = (goal[1] - start[1] + math.pi) % (2 * math.pi) - math.pi
    path = np.array((goal[0] - start[0], around, goal[2] - start[2]))

    rows = [_box(rng, workspace, start, path) for _ in range(rng.integers(3, MAX_BOXES + 1))]
    rows += [_post(rng, workspace, start, path) for _ in range(rng.integers(1, MAX_POSTS + 1))]
    if rng.random() < SHELVES:
        rows += _shelf(rng, workspace, target)
    boxes = Boxes(*(np.array(part, dtype=float) for part in zip(*rows, strict=True)))
    apart = boxes.distances(target) >= tolerance + TARGET_MARGIN * scale
    apart &= model.box_distances(model.home, boxes) >= HOME_MARGIN * scale
    return ReachLayout(target, Boxes(boxes.centres[apart], boxes.half_sizes[apart], boxes.yaws[apart]))


def _box(rng: np.random.Generator, workspace: Workspace, start: Array, path: Array) -> Box:
    """Return a box near the end-effector path, on the floor or above it; `path` (3,) is in cylindrical coordinates."""
    scale = workspace.radius
    half_size = scale * rng.uniform(0.03, 0.12, 3)
    centre = workspace.centre + _cartesian(start + rng.uniform(0.2, 0.9) * path)
    centre = centre + scale * SPREAD * rng.normal(size=3)
    centre[2] = max(centre[2], half_size[2])
    return centre, half_size, rng.uniform(-math.pi, math.pi)


def _post(rng: np.random.Generator, workspace: Workspace, start: Array, path: Array) -> Box:
    """Return a post on the floor, in a direction that the arm turns through."""
    scale = workspace.radius
    radius, angle = scale * rng.uniform(0.35, 0.75), start[1] + rng.uniform(0.2, 0.9) * path[1]
    half_height = scale * rng.uniform(0.15, 0.45)
    centre = workspace.centre + _cartesian(np.array((radius, angle, 0.0)))
    centre[2] = half_height
    half_width = scale * POST_HALF_WIDTH
    return centre, np.array((half_width, half_width, half_height)), rng.uniform(-math.pi, math.pi)


def _shelf(rng: np.random.Generator, workspace: Workspace, target: Array) -> list[Box]:
    """Return boards below, above and behind the target: the shelf opens roughly towards the arm."""
    scale = workspace.radius
    yaw = math.atan2(*(target - workspace.centre)[1::-1]) + rng.normal(0, 0.3)
    depth, width, below, above = scale * rng.uniform((0.1, 0.15, 0.1, 0.1), (0.15, 0.25, 0.2, 0.25))
    outward, up = np.array((math.cos(yaw), math.sin(yaw), 0.0)), np.array((0.0, 0.0, 1.0))
    board, half_height = scale * BOARD_HALF_THICKNESS, (below + above) / 2
    middle = target + up * (above - below) / 2
    return [
        (target - up * below, np.array((depth, width, board)), yaw),
        (target + up * above, np.array((depth, width, board)), yaw),
        (middle + outward * depth, np.array((board, width, half_height)), yaw),
    ]


def _cylindrical(point: Array) -> Array:
    """Return cylindrical coordinates of a point: distance from the vertical axis, angle around it, height."""
    return np.array((math.hypot(point[0], point[1]), math.atan2(point[1], point[0]), point[2]))


def _cartesian(cylindrical: Array) -> Array:
    radius, angle, height = cylindrical
    return np.array((radius * math.cos(angle), radius * math.sin(angle), height))
