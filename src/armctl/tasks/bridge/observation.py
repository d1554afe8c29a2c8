"""Camera images and full states of n bridge worlds, and their observation spaces."""

from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.robots.rover import CAMERA, GEOM_GROUP, PREFIX, WHEEL_RADIUS, WHEELS
from armctl.simulation import Camera, RayCamera, Simulation
from armctl.tasks.bridge.layout import MAX_BLOCK_YAW
from armctl.tasks.bridge.options import BridgeOptions
from armctl.tasks.bridge.pedestrians import Pedestrians
from armctl.tasks.bridge.state import BridgeState
from armctl.tasks.bridge.world import CONTACT_CLASSES, LOOKS
from armctl.tasks.task import Ids

PIXEL_CLASSES = ("sky", *CONTACT_CLASSES)
"""Pixels of the camera `classes` are indices into these."""

NEAR = np.float32(0.5)
"""m: depth whose nearness is a half."""
OFF_DECK = 10.0
"""m beside the deck within which a rover is, wherever it was thrown; its episode ends as soon as it is off the deck."""
FASTEST = np.array([20.0, 35.0])
"""Forward velocity (m/s) and yaw rate (rad/s) beyond which sensors do not measure: a gyro's range of 2000 degrees/s."""
FASTEST_MOTION = FASTEST[[0, 1, 1]].astype(np.float32)
ROVER, BLOCK, WALKER = 6, 5, 4
"""Numbers of `full_state` for the rover itself, for each block and for each walker."""
See = Callable[[Ids | None], NDArray[Any]]
"""Images (n, height, width, ...) of some worlds, or of all."""


def make_camera(simulation: Simulation, options: BridgeOptions) -> See:
    """Return the camera of `options`. Raises `ConfigurationError` for `rgb` without OpenGL."""
    see = _make_sensor(simulation, options)
    if options.camera == "rgb":
        return see
    convert = _nearness if options.view == "features" else _same
    highest = {"classes": len(PIXEL_CLASSES) - 1, "depth": options.camera_range}[options.camera]
    if options.view == "features":
        highest = 1.0
    if options.image_format == "float":
        return lambda ids: convert(see(ids))
    return lambda ids: np.rint(convert(see(ids)) * np.float32(255 / highest)).astype(np.uint8)[..., None]


def _make_sensor(simulation: Simulation, options: BridgeOptions) -> See:
    if options.camera == "rgb":
        try:
            pictures = Camera(simulation.model, CAMERA, *options.size)
        except ConfigurationError as error:
            raise ConfigurationError(f"{error}. Without it, camera='depth' and camera='classes' work") from error
        return lambda ids: np.stack(
            [pictures.picture(simulation.data(i)) for i in (range(simulation.n) if ids is None else ids.tolist())]
        )
    rays = RayCamera(simulation, CAMERA, options.size, options.field_of_view, (GEOM_GROUP, LOOKS))
    if options.camera == "depth":
        return lambda ids: rays.depth(options.camera_range, ids)
    classes = pixel_classes(simulation.model)
    return lambda ids: rays.classes(classes, PIXEL_CLASSES.index("sky"), ids)


def _same(images: NDArray[Any]) -> NDArray[Any]:
    return images


def _nearness(depths: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return nearness: 1 at the camera, a half at `NEAR`, 0 at infinity."""
    return NEAR / (NEAR + depths)


def full_state(state: BridgeState, blocks: Array, pedestrians: Pedestrians) -> NDArray[np.float32]:
    """Return pose (x, y, cos yaw, sin yaw), velocities, blocks (5 each) and pedestrians (4 each), (n, k)."""
    n, (x, y, yaw) = len(blocks), state.poses.T
    velocities = np.clip(state.velocities, -FASTEST, FASTEST)
    rover = np.column_stack((x, y, np.cos(yaw), np.sin(yaw), velocities))
    people = np.concatenate((pedestrians.positions(state.time), pedestrians.velocities(state.time)), axis=-1)
    return np.concatenate((rover, blocks.reshape(n, -1), people.reshape(n, -1)), axis=1, dtype=np.float32)


def observation_space(options: BridgeOptions) -> gymnasium.spaces.Space[Any]:
    """Return the observation space of one world."""
    if options.view == "state":
        return state_space(options)
    motion = gymnasium.spaces.Box(-FASTEST_MOTION, FASTEST_MOTION, dtype=np.float32)
    if options.view == "ranges":
        ranges = gymnasium.spaces.Box(0, np.float32(options.camera_range), options.size[:1], dtype=np.float32)
        return gymnasium.spaces.Dict({"ranges": ranges, "motion": motion})
    image = _image_space(options)
    return image if options.view == "image" else gymnasium.spaces.Dict({"image": image, "motion": motion})


def state_space(options: BridgeOptions) -> gymnasium.spaces.Box:
    """Return the space of one world's `full_state`."""
    return gymnasium.spaces.Box(*_state_bounds(options), dtype=np.float32)


def _image_space(options: BridgeOptions) -> gymnasium.spaces.Box:
    width, height = options.size
    if options.camera == "rgb":
        return gymnasium.spaces.Box(0, 255, (height, width, 3), dtype=np.uint8)
    if options.image_format == "uint8":
        return gymnasium.spaces.Box(0, 255, (height, width, 1), dtype=np.uint8)
    if options.camera == "classes":
        return gymnasium.spaces.Box(0, len(PIXEL_CLASSES) - 1, (height, width), dtype=np.uint8)
    highest = 1.0 if options.view == "features" else options.camera_range
    return gymnasium.spaces.Box(0, np.float32(highest), (height, width), dtype=np.float32)


def _state_bounds(options: BridgeOptions) -> NDArray[np.float32]:
    """Return the lowest and highest of each number of `full_state`, (2, k)."""
    length, width = options.deck_length, options.deck_width / 2
    rover = [length + OFF_DECK, width + OFF_DECK, 1.0, 1.0, *FASTEST]
    block = [length, width, MAX_BLOCK_YAW, *options.largest_block]
    walker = [length, width, options.fastest_walker, options.fastest_walker]
    highest = np.array([*rover, *block * options.blocks, *walker * options.walkers], dtype=np.float32)
    return np.stack((-highest, highest))


def camera_pitch(model: mujoco.MjModel) -> float:
    """Return the angle by which the camera looks down while the rover stands, rad."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.camera(CAMERA).quat)
    return float(np.arcsin(rotation[8]))


def camera_numbers(options: BridgeOptions, model: mujoco.MjModel) -> tuple[dict[str, float], dict[str, float]]:
    """Return what networks are told of the camera: its optics and pitch, and its mount.

    The mount is the height `above` the deck at rest, m, and the `lift` in m per rad that the nose rises about the rear
    axle when the rover accelerates.
    """
    ahead, _, above = model.camera(CAMERA).pos
    rear = min(model.body(PREFIX + name).pos[0] for name in WHEELS)
    optics = {"field_of_view": options.field_of_view, "farthest": options.camera_range, "pitch": camera_pitch(model)}
    return optics, {"above": float(above) + WHEEL_RADIUS, "lift": float(ahead - rear)}


def column_directions(options: BridgeOptions, pitch: float) -> Array:
    """Return (width, 2) unit vectors, ahead and left, in which the columns of the camera's image see the horizon.

    The camera looks down by `pitch` rad.
    """
    width, _ = options.size
    left = np.tan(np.radians(options.field_of_view) / 2) * (1 - (2 * np.arange(width) + 1) / width)
    bearings = np.arctan2(left, 1 / np.cos(pitch))
    return np.column_stack((np.cos(bearings), np.sin(bearings)))


def pixel_classes(model: mujoco.MjModel) -> NDArray[np.uint8]:
    """Return the index into `PIXEL_CLASSES` of each geom, (ngeom,)."""
    classes = np.zeros(model.ngeom, dtype=np.uint8)
    for i, (kind, name) in enumerate(CONTACT_CLASSES.values(), start=1):
        if kind == mujoco.mjtObj.mjOBJ_GEOM:
            classes[model.geom(name).id] = i
        else:
            classes[[_below(model, body, model.body(name).id) for body in model.geom_bodyid]] = i
    return classes


def _below(model: mujoco.MjModel, body: int, ancestor: int) -> bool:
    while body not in (0, ancestor):
        body = model.body_parentid[body]
    return bool(body == ancestor)
