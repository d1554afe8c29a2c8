"""Bridge crossing: a skid-steer rover drives to the goal line at the far end, and touches nothing on the way.

What is rewarded is easy to change: see `REWARD`, and `BridgeOptions`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.errors import ConfigurationError, unknown_name
from armctl.planning import BridgeMap, Courses
from armctl.robots.rover import CAMERA, GEOM_GROUP, MAX_VELOCITY, PARTS, RADIUS, WHEEL_RADIUS, Rover
from armctl.simulation import Camera, ContactSensors, RayCamera, Simulation
from armctl.tasks.bridge_layout import Layout, draw_layout
from armctl.tasks.bridge_world import (
    CONTACT_CLASSES,
    GOAL_MARGIN,
    HIDDEN,
    LOOKS,
    WALKER_RADIUS,
    block_names,
    build_bridge_world,
    segment_names,
    walker_names,
)
from armctl.tasks.task import Motion, Observations, Outcome, RewardLedger, Task

Array = NDArray[np.float64]

DECISION_PERIOD = 0.1
"""s between two decisions."""
WALKER_PERIOD = 0.02
"""s between two moves of the walkers: 24 mm of the quickest one."""
MOVES = round(DECISION_PERIOD / WALKER_PERIOD)
"""Of the walkers, between two decisions; what the wheels bear is sampled as often."""
CAMERAS = ("depth", "classes", "rgb")
OBSERVATIONS = ("camera", "state")
PIXEL_CLASSES = ("sky", *CONTACT_CLASSES)
"""What the camera `classes` tells apart: a pixel is an index into these."""


@dataclass(frozen=True, eq=False)
class BridgeState:
    """What reward terms may look at; every array has a leading axis n, the number of worlds."""

    time: Array
    """Since the episode began, s, (n,)."""
    poses: Array
    """True x, y (m) and yaw (rad) of the rover, (n, 3)."""
    velocities: Array
    """True linear velocity ahead (m/s) and yaw rate (rad/s), (n, 2)."""
    distance: Array
    """To the goal line, m, (n,)."""
    previous_distance: Array
    """The distance one decision ago, m, (n,); after a reset, `distance`."""
    contacts: NDArray[np.bool_]
    """What each part has touched since the last decision, (n, `PARTS`, `CONTACT_CLASSES`)."""
    crossed: NDArray[np.bool_]
    """A part has touched the goal line, and none anything that it must not, (n,)."""
    collided: NDArray[np.bool_]
    """A part has touched a barrier or an obstacle, or the base the floor, (n,)."""
    fell: NDArray[np.bool_]
    """A wheel has dropped over the edge of the deck, (n,)."""
    action: Array
    """Linear and angular velocity commanded last, before clipping, (n, 2); zeros after a reset."""


Term = Callable[[BridgeState], NDArray[np.floating[Any]]]

REWARD: dict[str, Term] = {
    "time": lambda state: np.full(len(state.crossed), -0.1),
    "goal": lambda state: np.where(state.crossed, 100.0, 0.0),
    "collision": lambda state: np.where(state.collided, -100.0, 0.0),
    "fall": lambda state: np.where(state.fell, -100.0, 0.0),
}
"""Named reward terms, (n,) each; the reward is their sum."""


@dataclass(frozen=True)
class BridgeOptions:
    """Options of the bridge environments."""

    deck_length: float = 20.0
    """m."""
    deck_width: float = 4.0
    """m, of which the barriers take 1.22."""
    blocks: int = 7
    """Barrier blocks on the deck, placed anew each episode."""
    walkers: int = 0
    """People-sized obstacles that walk across and along the bridge."""
    missing_barriers: int = 1
    """Jersey barriers that are missing, others each episode: there the drop is open."""
    observation: str = "camera"
    """`camera`: a dict of `image` and own `motion`. `state`: pose, velocity and surroundings."""
    camera: str = "depth"
    """`depth` (m, along the optical axis), `classes` (an index into `PIXEL_CLASSES`) or `rgb` (needs OpenGL)."""
    resolution: tuple[int, int] = (48, 32)
    """Of the camera: width and height, pixels."""
    field_of_view: float = 110.0
    """Of the camera, horizontally, degrees."""
    camera_range: float = 10.0
    """Largest depth that the camera tells, m."""
    timestep: float = 0.005
    """Of the physics, s; see `benchmarks/physics_step.py`."""
    progress: float = 0.0
    """Reward for each metre nearer to the goal line, as one more reward term."""
    reward: Mapping[str, Term] = field(default_factory=lambda: REWARD)
    """Named reward terms."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("deck_length", 8, 200), ("deck_width", 3, 20), ("field_of_view", 20, 150), ("camera_range", 0.5, 1000),
            ("timestep", 1e-5, 0.02), ("progress", -1e6, 1e6),
        ):  # fmt: skip
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and low <= value <= high):
                raise ConfigurationError(f"{name} is a number from {low} to {high}, not {value!r}")
        for name, high in (("blocks", 50), ("walkers", 20), ("missing_barriers", 100)):
            value = getattr(self, name)
            if not (isinstance(value, int) and 0 <= value <= high):
                raise ConfigurationError(f"{name} is a whole number from 0 to {high}, not {value!r}")
        if not _is_resolution(self.resolution):
            raise ConfigurationError(f"resolution is (width, height), each 4 to 1024 pixels, not {self.resolution!r}")
        for name, allowed in (("camera", CAMERAS), ("observation", OBSERVATIONS)):
            if getattr(self, name) not in allowed:
                raise unknown_name(name, getattr(self, name), allowed)
        chunks = WALKER_PERIOD / self.timestep
        if abs(chunks - round(chunks)) > 1e-6:
            raise ConfigurationError(
                f"timestep divides {WALKER_PERIOD} s without remainder, which {self.timestep} does not"
            )
        if not isinstance(self.reward, Mapping) or not all(callable(term) for term in self.reward.values()):
            raise ConfigurationError(f"reward is a mapping from names to functions, not {self.reward!r}")


def _is_resolution(resolution: Any) -> bool:
    return (
        isinstance(resolution, (tuple, list))
        and len(resolution) == 2
        and all(isinstance(side, int) and 4 <= side <= 1024 for side in resolution)
    )


class BridgeTask(Task):
    """n bridges, each with a rover."""

    camera = "overview"

    def __init__(self, n: int, options: BridgeOptions, threads: int = 0) -> None:
        self.options = options
        substeps = round(DECISION_PERIOD / options.timestep)
        model = build_bridge_world(
            options.deck_length,
            options.deck_width,
            options.blocks,
            options.walkers,
            options.timestep,
            substeps,
            options.resolution,
            options.field_of_view,
        )
        self.simulation = Simulation(model, n, threads)
        self.substeps = substeps
        self.rover = Rover(self.simulation)
        self.joints = self.rover.wheel_samples(MOVES, DECISION_PERIOD)
        self.goal_x = options.deck_length - GOAL_MARGIN
        self._terms = dict(options.reward)
        if options.progress:
            self._terms["progress"] = lambda state: options.progress * (state.previous_distance - state.distance)
        self._contacts = ContactSensors(self.simulation, PARTS, CONTACT_CLASSES)
        self._positions, self._rotations = (self.simulation.per_world(name) for name in ("body_pos", "body_quat"))
        self._barrier_bodies, self._block_bodies, self._walker_bodies = (
            np.array([model.body(name).id for name in names], dtype=int)
            for names in (
                segment_names(options.deck_length), block_names(options.blocks), walker_names(options.walkers),
            )
        )  # fmt: skip
        self._see = self._make_camera(model, n)
        walkers = (n, options.walkers)
        self._courses = Courses(
            np.zeros((*walkers, 2)), np.zeros((*walkers, 2)), np.zeros(walkers), np.zeros(walkers), WALKER_RADIUS
        )
        self._layouts: list[Layout] = [self._draw(np.random.default_rng(0))] * n
        self._time, self._action, self._distance = np.zeros(n), np.zeros((n, 2)), np.zeros(n)
        self.reset(np.arange(n, dtype=np.int32), [np.random.default_rng(0)] * n)
        self._check_reward(n)
        limits = np.float32(MAX_VELOCITY)
        self.action_space = gymnasium.spaces.Box(-limits, limits, dtype=np.float32)
        self.observation_space = self._make_observation_space()

    @property
    def interface(self) -> dict[str, str]:
        """Robot, and what is observed."""
        if self.options.observation == "state":
            return {
                "robot": "rover",
                "observation": f"state of {self.options.blocks} blocks, {self.options.walkers} walkers",
            }
        width, height = self.options.resolution
        seen = f", to {self.options.camera_range:g} m" if self.options.camera == "depth" else ""
        return {
            "robot": "rover",
            "observation": "camera and motion",
            "camera": f"{self.options.camera} {width} x {height}, {self.options.field_of_view:g} degrees{seen}",
        }

    def map(self, world: int) -> BridgeMap:
        """What is on the bridge of a world: privileged knowledge."""
        return self._layouts[world].map

    def reset(self, ids: NDArray[np.int32], rngs: list[np.random.Generator]) -> None:
        """The rover stands at the start, and all else is somewhere new."""
        self.simulation.reset(ids)
        for i, rng in zip(ids, rngs, strict=True):
            self._layouts[i] = self._draw(rng)
            self._furnish(i, self._layouts[i])
        self._time[ids] = 0.0
        self._move_walkers(ids)
        self.simulation.refresh(ids)
        self._action[ids] = 0.0
        self._distance[ids] = self.goal_x - self.rover.poses[ids, 0]
        self._look(self._contacts.lately())

    def command(self, actions: Array) -> None:
        """Linear and angular velocities (n, 2), m/s and rad/s."""
        self._action = actions
        self._distance = self.state.distance
        self.rover.command(actions)

    def advance(self, ids: NDArray[np.int32] | None) -> None:
        """Let time go on until the next decision, in worlds `ids`."""
        worlds = np.arange(len(self._time), dtype=np.int32) if ids is None else ids
        for _ in range(MOVES):
            self._time[worlds] += DECISION_PERIOD / MOVES
            self._move_walkers(worlds)
            self.simulation.step(self.substeps // MOVES, ids)
            self.joints.take()

    def parts(self) -> dict[str, NDArray[np.floating[Any]]]:
        """Pose, velocity and own motion."""
        return {"pose": self.state.poses, "velocity": self.state.velocities, "motion": self._motion()}

    def observe(self, ids: NDArray[np.int32] | None = None) -> Observations:
        """Observations: `image` (n, height, width) and `motion` (n, 3), or the state (n, k)."""
        worlds = slice(None) if ids is None else ids
        if self.options.observation == "state":
            return self._surroundings()[worlds]
        return {"image": self._see(ids), "motion": self._motion().astype(np.float32)[worlds]}

    def score(self) -> RewardLedger:
        """The terms of `BridgeOptions.reward`."""
        self._look(self._contacts.lately())
        return {name: np.array(term(self.state), dtype=float) for name, term in self._terms.items()}

    def outcome(self) -> NDArray[np.int8]:
        """`CROSSED`, `COLLIDED`, `FELL`, or `TIMEOUT` as long as it is none of them."""
        state = self.state
        return np.select(
            (state.fell, state.collided, state.crossed),
            (np.int8(Outcome.FELL), np.int8(Outcome.COLLIDED), np.int8(Outcome.CROSSED)),
            np.int8(Outcome.TIMEOUT),
        )

    def details(self) -> dict[str, Any]:
        """`contacts`: whether each part has touched each class of things since the last decision.

        `feasible`: whether the bridge can be crossed. It always can: `draw_layout` takes no other.
        """
        touched = self.state.contacts
        return {
            "feasible": np.ones(len(touched), dtype=bool),
            "contacts": {
                part: {label: touched[:, i, j] for j, label in enumerate(CONTACT_CLASSES)}
                for i, part in enumerate(PARTS)
            },
        }

    def motion(self) -> Motion:
        """How the rovers move now; a contact is one with barrier, obstacle or, of the base, the floor."""
        samples = self.joints.since_last_decision()
        return Motion(self.rover.positions.copy(), self.state.poses, samples, self.state.collided)

    def least_clearance(self, world: int, configurations: Array) -> float:
        """Least distance, m, to sides, blocks and people of the disc that the rover can turn in; below 0 within it."""
        bridge, points = self.map(world), configurations[:, :2]
        standing = np.linalg.norm(bridge.nearest(points) - points[:, None], axis=-1)
        times = DECISION_PERIOD * np.arange(1, len(points) + 1)
        walking = np.linalg.norm(bridge.courses.positions(times) - points[:, None], axis=-1) - bridge.courses.radius
        return float(min(standing.min(), walking.min(initial=np.inf))) - RADIUS

    def _draw(self, rng: np.random.Generator) -> Layout:
        options = self.options
        return draw_layout(
            rng, options.deck_length, options.deck_width, options.blocks, options.walkers, options.missing_barriers
        )

    def _furnish(self, world: int, layout: Layout) -> None:
        positions, rotations = self._positions[world], self._rotations[world]
        positions[self._barrier_bodies, 2] = 0.0
        positions[self._barrier_bodies[layout.missing], 2] = HIDDEN
        x, y, yaw, *_ = layout.map.blocks.T
        positions[self._block_bodies] = np.column_stack((x, y, np.zeros_like(x)))
        rotations[self._block_bodies] = np.column_stack((np.cos(yaw / 2), 0 * yaw, 0 * yaw, np.sin(yaw / 2)))
        positions[self._walker_bodies, 2] = 0.0
        for name in ("start", "end", "speed", "phase"):
            getattr(self._courses, name)[world] = getattr(layout.map.courses, name)

    def _move_walkers(self, worlds: NDArray[np.int32]) -> None:
        if self.options.walkers:
            places = self._courses.positions(self._time)
            self._positions[worlds[:, None], self._walker_bodies, :2] = places[worlds]

    def _look(self, contacts: NDArray[np.bool_]) -> None:
        label = {name: i for i, name in enumerate(CONTACT_CLASSES)}
        poses = self.rover.poses
        base_on_floor = contacts[:, PARTS.index("base"), label["floor"]]
        collided = contacts[:, :, (label["barrier"], label["obstacle"])].any(axis=(1, 2)) | base_on_floor
        fell = np.asarray((self.rover.wheel_heights < WHEEL_RADIUS / 2).any(axis=1))
        at_goal = contacts[:, :, label["goal"]].any(axis=1)
        self.state = BridgeState(
            time=self._time.copy(),
            poses=poses,
            velocities=self.rover.velocities,
            distance=self.goal_x - poses[:, 0],
            previous_distance=self._distance,
            contacts=contacts,
            crossed=at_goal & ~collided & ~fell,
            collided=collided & ~fell,
            fell=fell,
            action=self._action,
        )

    def _motion(self) -> Array:
        """Odometry (m/s, rad/s) and the gyro's yaw rate (rad/s), (n, 3)."""
        return np.column_stack((self.rover.odometry, self.rover.gyro[:, 2]))

    def _surroundings(self) -> NDArray[np.float32]:
        """Pose (x, y, cos yaw, sin yaw), velocities, blocks (5 each) and walkers (position and velocity), (n, k)."""
        n, (x, y, yaw) = len(self._time), self.state.poses.T
        blocks = np.array([layout.map.blocks for layout in self._layouts]).reshape(n, -1)
        walkers = np.concatenate((self._courses.positions(self._time), self._courses.velocities(self._time)), axis=-1)
        own = np.column_stack((x, y, np.cos(yaw), np.sin(yaw), self.state.velocities))
        return np.concatenate((own, blocks, walkers.reshape(n, -1)), axis=1, dtype=np.float32)

    def _make_camera(self, model: mujoco.MjModel, n: int) -> Callable[[NDArray[np.int32] | None], NDArray[Any]]:
        options = self.options
        if options.camera == "rgb":
            try:
                pictures = Camera(model, CAMERA, *options.resolution)
            except ConfigurationError as error:
                raise ConfigurationError(f"{error}. Without it, camera='depth' and camera='classes' work") from error
            return lambda ids: np.stack(
                [pictures.picture(self.simulation.data(i)) for i in (range(n) if ids is None else ids.tolist())]
            )
        rays = RayCamera(self.simulation, CAMERA, options.resolution, options.field_of_view, (GEOM_GROUP, LOOKS))
        if options.camera == "depth":
            return lambda ids: rays.depth(options.camera_range, ids)
        classes = pixel_classes(model)
        return lambda ids: rays.classes(classes, PIXEL_CLASSES.index("sky"), ids)

    def _make_observation_space(self) -> gymnasium.spaces.Space[Any]:
        options = self.options
        seen = self.observe()
        if isinstance(seen, np.ndarray):
            return gymnasium.spaces.Box(-np.inf, np.inf, seen.shape[1:], dtype=np.float32)
        shape = seen["image"].shape[1:]
        images: dict[str, gymnasium.spaces.Space[Any]] = {
            "depth": gymnasium.spaces.Box(0, np.float32(options.camera_range), shape, dtype=np.float32),
            "classes": gymnasium.spaces.Box(0, len(PIXEL_CLASSES) - 1, shape, dtype=np.uint8),
            "rgb": gymnasium.spaces.Box(0, 255, shape, dtype=np.uint8),
        }
        motion = gymnasium.spaces.Box(-np.inf, np.inf, (3,), dtype=np.float32)
        return gymnasium.spaces.Dict({"image": images[options.camera], "motion": motion})

    def _check_reward(self, n: int) -> None:
        for name, earned in self.score().items():
            if earned.shape != (n,):
                raise ConfigurationError(f"the reward term {name!r} is one number a world, ({n},), not {earned.shape}")


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
