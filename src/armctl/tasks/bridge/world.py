"""Builds the bridge's MuJoCo model: deck, barriers, blocks, walkers and the rover, in the sizes of the options."""

from typing import Any

import mujoco
import numpy as np

from armctl.robots.rover import PARTS, PREFIX, SPEED_LIMITS, add_rover
from armctl.simulation.contacts import add_contact_sensors
from armctl.simulation.impacts import add_impact_sensors
from armctl.simulation.ray_camera import vertical_field_of_view
from armctl.simulation.worlds import compiled_once, world_path
from armctl.tasks.bridge.options import WALKER_RADIUS

START_X, GOAL_MARGIN = 1.0, 1.0
"""m from the deck's ends to the rover's start, and to the goal line."""
SEGMENT_LENGTH = 4.0
"""m, largest length of one jersey barrier."""
JERSEY_PROFILE = ((0.305, 0.0), (0.305, 0.075), (0.12, 0.33), (0.075, 0.81))
"""Half width and height, m, of the New Jersey barrier's corners (FHWA)."""
BLOCK_SIZES = ((0.2, 0.7), (0.25, 0.5), (0.3, 0.3), (0.2, 0.8))
"""Half length and half width, m, in turn."""
BLOCK_HEIGHT = 0.8
WALKER_HEIGHT = 1.7
SLAB_DEPTH, GROUND = 0.4, -4.0
LOOKS = 2
"""Geom group of purely visual geoms."""
HIDDEN = -50.0
"""Height, m, at which missing barriers are hidden: below the water."""

CONTACT_CLASSES = {
    "floor": (mujoco.mjtObj.mjOBJ_GEOM, "asphalt"),
    "deck": (mujoco.mjtObj.mjOBJ_GEOM, "deck"),
    "barrier": (mujoco.mjtObj.mjOBJ_XBODY, "barriers"),
    "obstacle": (mujoco.mjtObj.mjOBJ_XBODY, "walkers"),
    "goal": (mujoco.mjtObj.mjOBJ_GEOM, "goal_line"),
    "ground": (mujoco.mjtObj.mjOBJ_GEOM, "ground"),
}
"""Classes of objects that the rover can touch: `floor` is the top of the asphalt, `deck` the concrete below it."""


def free_half_width(deck_width: float) -> float:
    """Return the distance from the middle of a deck to its barriers' feet, m."""
    return deck_width / 2 - 2 * JERSEY_PROFILE[0][0]


def segment_names(length: float) -> list[str]:
    """Return the bodies of the jersey barriers, from start to goal, alternating left and right."""
    return [f"{side}_barrier_{i}" for i in range(int(np.ceil(length / SEGMENT_LENGTH))) for side in ("left", "right")]


def block_names(count: int) -> list[str]:
    """Return the bodies of the barrier blocks."""
    return [f"block_{i}" for i in range(count)]


def walker_names(count: int) -> list[str]:
    """Return the bodies of the moving obstacles."""
    return [f"walker_{i}" for i in range(count)]


@compiled_once
def build_bridge_world(
    length: float,
    width: float,
    blocks: int,
    walker_radii: tuple[float, ...],
    timestep: float,
    memory: int,
    resolution: tuple[int, int],
    field_of_view: float,
) -> mujoco.MjModel:
    """Return a bridge of `length` by `width` (m), with the rover standing at its start in the keyframe `start`.

    `walker_radii` are those of the moving obstacles, m. Contact sensors remember `memory` physics steps.
    """
    spec = mujoco.MjSpec.from_file(str(world_path("bridge")))
    spec.option.timestep = timestep
    _resize_deck(spec, length, width)
    _add_jersey_barriers(spec, length, width)
    for i, name in enumerate(block_names(blocks)):
        body = spec.body("barriers").add_body(name=name, pos=[0, 0, HIDDEN])
        half_length, half_width = BLOCK_SIZES[i % len(BLOCK_SIZES)]
        size = [half_length, half_width, BLOCK_HEIGHT / 2]
        _add_box(body, size, [0, 0, BLOCK_HEIGHT / 2], "block")
    for name, radius in zip(walker_names(len(walker_radii)), walker_radii, strict=True):
        _add_walker(spec.body("walkers").add_body(name=name, pos=[0, 0, HIDDEN]), radius)
    add_rover(spec, (START_X, 0.0))
    spec.camera(PREFIX + "front").fovy = vertical_field_of_view(resolution, field_of_view)
    add_contact_sensors(
        spec, {part: (mujoco.mjtObj.mjOBJ_BODY, PREFIX + part) for part in PARTS}, CONTACT_CLASSES, memory
    )
    add_impact_sensors(spec, SPEED_LIMITS, memory, body=PREFIX + "base")
    _add_start(spec)
    return spec.compile()


def _resize_deck(spec: Any, length: float, width: float) -> None:
    for name in ("asphalt", "deck"):
        geom = spec.geom(name)
        geom.size = [length / 2, width / 2, geom.size[2]]
        geom.pos = [length / 2, 0, geom.pos[2]]
    goal = spec.geom("goal_line")
    goal.size = [goal.size[0], width / 2, goal.size[2]]
    goal.pos = [length - GOAL_MARGIN, 0, goal.pos[2]]
    overview = spec.camera("overview")
    overview.pos = overview.pos * max(length / 20.0, width / 10.0)  # the MJCF's is for 20 m by at most 10 m
    world = spec.worldbody
    for y in (-0.35 * width, 0.35 * width):
        _add_box(world, [length / 2, 0.15, 0.25], [length / 2, y, -SLAB_DEPTH - 0.25], "concrete", LOOKS)
    for x in np.arange(2.0, length, 5.3):
        _add_box(world, [0.3, 0.45 * width, 0.15], [x, 0, -SLAB_DEPTH - 0.65], "concrete", LOOKS)
        top = -SLAB_DEPTH - 0.8
        _add_box(world, [0.25, 0.3 * width, (top - GROUND) / 2], [x, 0, (top + GROUND) / 2], "concrete", LOOKS)
    for x in np.arange(1.5, length - GOAL_MARGIN - 1, 2.0):
        _add_box(world, [0.5, 0.05, 0.001], [x, 0, 0], "paint", LOOKS)


def _add_box(body: Any, size: Any, pos: Any, material: str, group: int = 0) -> None:
    collides = int(group != LOOKS)
    kind = mujoco.mjtGeom.mjGEOM_BOX
    body.add_geom(type=kind, size=size, pos=pos, material=material, group=group, contype=collides, conaffinity=collides)


def _add_jersey_barriers(spec: Any, length: float, width: float) -> None:
    names = segment_names(length)
    segment = length / (len(names) // 2)
    outline = [(y, z) for half, z in JERSEY_PROFILE for y in (-half, half)]
    gap = 0.02
    corners = [(x, y, z) for x in (-segment / 2 + gap, segment / 2 - gap) for y, z in outline]
    spec.add_mesh(name="jersey_barrier", uservert=np.ravel(corners))
    for i, name in enumerate(names):
        y = (width / 2 - JERSEY_PROFILE[0][0]) * (1 if i % 2 == 0 else -1)
        body = spec.body("barriers").add_body(name=name, pos=[segment * (i // 2 + 0.5), y, 0])
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="jersey_barrier", material="concrete")


def _add_walker(body: Any, radius: float) -> None:
    """Add a cylinder; one as slender as a person has a visual head."""
    shoulders = WALKER_HEIGHT - 0.25
    kind = mujoco.mjtGeom.mjGEOM_CYLINDER
    body.add_geom(type=kind, size=[radius, shoulders / 2, 0], pos=[0, 0, shoulders / 2], material="coat")
    if radius > WALKER_RADIUS:
        return
    head = 0.13
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[head, 0, 0], pos=[0, 0, WALKER_HEIGHT - head], material="skin"
    )


def _add_start(spec: Any) -> None:
    """Add the keyframe `start`, in which the rover's tyres have settled under its weight."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(2.0 / model.opt.timestep))
    at_rest = model.qpos0.copy()
    at_rest[2] = data.qpos[2]
    spec.add_key(name="start", qpos=at_rest)
