"""Camera images and full states of n bridge worlds, and their observation spaces."""

from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.errors import ConfigurationError
from armctl.robots.rover import CAMERA, GEOM_GROUP
from armctl.scene import PedestrianTrajectories
from armctl.simulation import Camera, RayCamera, Simulation
from armctl.tasks.bridge.state import BridgeState
from armctl.tasks.bridge.world import CONTACT_CLASSES, LOOKS
from armctl.tasks.task import Ids, Observations

Array = NDArray[np.float64]

PIXEL_CLASSES = ("sky", *CONTACT_CLASSES)
"""Pixels of the camera `classes` are indices into these."""

See = Callable[[Ids | None], NDArray[Any]]
"""Images (n, height, width, ...) of some worlds, or of all."""


def make_camera(
    simulation: Simulation, kind: str, resolution: tuple[int, int], field_of_view: float, camera_range: float
) -> See:
    """The camera of `BridgeOptions`. Raises `ConfigurationError` for `rgb` without OpenGL."""
    if kind == "rgb":
        try:
            pictures = Camera(simulation.model, CAMERA, *resolution)
        except ConfigurationError as error:
            raise ConfigurationError(f"{error}. Without it, camera='depth' and camera='classes' work") from error
        return lambda ids: np.stack(
            [pictures.picture(simulation.data(i)) for i in (range(simulation.n) if ids is None else ids.tolist())]
        )
    rays = RayCamera(simulation, CAMERA, resolution, field_of_view, (GEOM_GROUP, LOOKS))
    if kind == "depth":
        return lambda ids: rays.depth(camera_range, ids)
    classes = pixel_classes(simulation.model)
    return lambda ids: rays.classes(classes, PIXEL_CLASSES.index("sky"), ids)


def full_state(state: BridgeState, blocks: Array, pedestrians: PedestrianTrajectories) -> NDArray[np.float32]:
    """Pose (x, y, cos yaw, sin yaw), velocities, blocks (5 each) and pedestrians (position and velocity), (n, k)."""
    n, (x, y, yaw) = len(blocks), state.poses.T
    own = np.column_stack((x, y, np.cos(yaw), np.sin(yaw), state.velocities))
    people = np.concatenate((pedestrians.positions(state.time), pedestrians.velocities(state.time)), axis=-1)
    return np.concatenate((own, blocks.reshape(n, -1), people.reshape(n, -1)), axis=1, dtype=np.float32)


def make_observation_space(seen: Observations, kind: str, camera_range: float) -> gymnasium.spaces.Space[Any]:
    """The observation space of one world, from the observations of all worlds."""
    if isinstance(seen, np.ndarray):
        return gymnasium.spaces.Box(-np.inf, np.inf, seen.shape[1:], dtype=np.float32)
    shape = seen["image"].shape[1:]
    images: dict[str, gymnasium.spaces.Space[Any]] = {
        "depth": gymnasium.spaces.Box(0, np.float32(camera_range), shape, dtype=np.float32),
        "classes": gymnasium.spaces.Box(0, len(PIXEL_CLASSES) - 1, shape, dtype=np.uint8),
        "rgb": gymnasium.spaces.Box(0, 255, shape, dtype=np.uint8),
    }
    motion = gymnasium.spaces.Box(-np.inf, np.inf, (3,), dtype=np.float32)
    return gymnasium.spaces.Dict({"image": images[kind], "motion": motion})


def pixel_classes(model: mujoco.MjModel) -> NDArray[np.uint8]:
    """Index into `PIXEL_CLASSES` of each geom, (ngeom,)."""
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
