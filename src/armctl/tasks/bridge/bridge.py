"""Bridge crossing: a skid-steer rover drives to the goal line at the far end without touching anything.

To change the reward, see `REWARD` and `BridgeOptions`.
"""

import copy
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array, Observations
from armctl.core.foresight import check_declared
from armctl.disturbances import ROVER
from armctl.robots.rover import MAX_VELOCITY, PARTS, PREFIX, RADIUS, SPEED_LIMITS, WHEEL_RADIUS
from armctl.scene import BridgeMap, PedestrianTrajectories
from armctl.simulation import Simulation
from armctl.tasks.bridge.furniture import Furniture
from armctl.tasks.bridge.layout import Layout, sample_layout, turning_y
from armctl.tasks.bridge.observation import (
    FASTEST_MOTION,
    See,
    camera_numbers,
    full_state,
    make_camera,
    observation_space,
    state_space,
)
from armctl.tasks.bridge.options import CONTROL_PERIOD, MOVES, BridgeMovingOptions, BridgeOptions
from armctl.tasks.bridge.pedestrians import on_lines_like
from armctl.tasks.bridge.perceived import PerceivedBridges
from armctl.tasks.bridge.physical import PhysicalRover
from armctl.tasks.bridge.planar import PlanarRover
from armctl.tasks.bridge.potentials import CrossingCostToGo, CrossingTimeToGo
from armctl.tasks.bridge.reactive import make_pedestrians
from armctl.tasks.bridge.state import BridgeState
from armctl.tasks.bridge.world import CONTACT_CLASSES, GOAL_MARGIN, build_bridge_world, free_half_width
from armctl.tasks.learner_view import FeatureSpec, LearnerView
from armctl.tasks.task import (
    Ids,
    MotionSample,
    Outcome,
    Potential,
    RewardTerms,
    Task,
    check_reward_terms,
)

LEARNER_VELOCITY = np.array([[-0.3, -2.0], [1.6, 2.0]], dtype=np.float32)
"""Lowest and highest linear (m/s) and angular velocity (rad/s) of a learner's actions."""


class BridgeOutcome(Outcome):
    """Outcome of an episode of a bridge task."""

    TIMEOUT = 0
    CROSSED = 1, True
    COLLIDED = 2
    FELL = 3


class BridgeTask(Task):
    """n bridges, each with a rover."""

    options_type: ClassVar[type[Any]] = BridgeOptions
    outcomes = BridgeOutcome
    instruction: ClassVar[str] = "Drive across the bridge to the goal line without touching anything."
    default_policies: ClassVar[tuple[str, ...]] = ("bridge_ompl", "bridge_distil", "random")
    disturbances = ROVER
    interface_options = Task.interface_options | {
        "observation", "camera", "resolution", "field_of_view", "camera_range", "image_format",
    }  # fmt: skip
    potentials: ClassVar[Mapping[str, Callable[[Any], Potential]]] = {
        **Task.potentials, "ompl": CrossingCostToGo, "people": CrossingTimeToGo,
    }  # fmt: skip
    units: ClassVar[Mapping[str, str]] = {"motion": "m/s, rad/s, rad/s", "action": "speed, m/s; turn rate, rad/s"}
    render_fps = round(1 / CONTROL_PERIOD)

    def __init__(self, n: int, options: BridgeOptions, threads: int = 0) -> None:
        self.options = options
        self.foresight = ("pedestrians",) if options.walkers else ()
        memory = round(CONTROL_PERIOD / options.timestep)
        model = build_bridge_world(
            options.deck_length, options.deck_width, options.blocks, (options.walker_radius,) * options.walkers,
            options.timestep, memory, options.size, options.field_of_view,
        )  # fmt: skip
        super().__init__(Simulation(model, n, threads, SPEED_LIMITS), CONTROL_PERIOD)
        self.goal_x = options.deck_length - GOAL_MARGIN
        self.reward_functions = dict(options.reward)
        if options.progress:
            self.reward_functions["progress"] = lambda state: (
                options.progress * (state.previous_distance - state.distance)
            )
        self._furniture = Furniture(self.simulation, options)
        self.rover = self._make_rover()
        self.joints, self.rollout_worlds = self.rover.joints, self.rover.rollout_worlds
        self._see = self._make_camera()
        worlds = np.arange(n, dtype=np.int32)
        self._layouts: list[Layout] = [self._sample_episode(np.random.default_rng(0))] * n
        self._pedestrians = on_lines_like(self._layouts[0].map.pedestrians, n)
        self._people = make_pedestrians(self._pedestrians, options)
        self._blocks = np.zeros((n, options.blocks, 5))
        self._time, self._action, self._distance = np.zeros(n), np.zeros((n, 2)), np.zeros(n)
        self.simulation.reset()
        self._begin(worlds)
        check_reward_terms(self.reward_terms(), n)
        limits = np.float32(MAX_VELOCITY)
        self.action_space = gymnasium.spaces.Box(-limits, limits, dtype=np.float32)
        self.observation_space, self.state_space = observation_space(options), state_space(options)

    @property
    def interface(self) -> dict[str, str]:
        """Robot and observation."""
        if self.options.view == "state":
            return {
                "robot": "rover",
                "observation": f"state of {self.options.blocks} blocks, {self.options.walkers} walkers",
            }
        width, height = self.options.size
        limit = f", to {self.options.camera_range:g} m" if self.options.camera == "depth" else ""
        return {
            "robot": "rover",
            "observation": {"camera": "camera and motion"}.get(self.options.view, self.options.view),
            "camera": f"{self.options.camera} {width} x {height}, {self.options.field_of_view:g} degrees{limit}",
        }

    @property
    def physical(self) -> bool:
        """True if masses, friction and pushes change anything."""
        return self.options.dynamics == "physics"

    @property
    def payload_body(self) -> str:
        """The rover's base."""
        return PREFIX + "base"

    @property
    def learner_view(self) -> LearnerView:
        """Features: scans of what is around the rover in a state, or how far it is in each column of a depth image."""
        options, half_width = self.options, free_half_width(self.options.deck_width)
        scans = FeatureSpec(
            "surroundings",
            {
                "blocks": options.blocks,
                "walkers": options.walkers,
                "half_width": half_width,
                "goal_x": self.goal_x,
                "radius": options.walker_radius,
                "turn": turning_y(half_width),
            },
        )
        if options.view == "state":
            return LearnerView(features=scans, state_features=scans)
        depths = (options.view, options.camera, options.image_format) == ("camera", "depth", "float")
        if options.view != "ranges" and not depths:
            return LearnerView(state_features=scans)
        measured, mount = camera_numbers(options, self.simulation.model)
        return LearnerView(
            features=FeatureSpec("nearness", {}, "column_ranges", measured),
            robust_features=FeatureSpec("held_nearness", {}, "floor_ranges", measured | mount),
            state_features=scans,
        )

    @property
    def action_range(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """The velocities in `LEARNER_VELOCITY`, mostly forwards."""
        return LEARNER_VELOCITY[0], LEARNER_VELOCITY[1]

    def map(self, world: int) -> BridgeMap:
        """Return the map of a world's bridge, which is privileged knowledge, with the pedestrians' whole trajectories.

        Those of pedestrians who give way are as they would go on if they met nobody any more. Raises
        `ConfigurationError` while a policy acts that does not declare to foresee these.
        """
        if self.granted is not None and self.foresight:
            check_declared("pedestrians", "state", self.granted)
        return self._people.on(self._layouts[world].map, world)

    def preview(self, name: str, world: int) -> PedestrianTrajectories:
        """Return a copy of the trajectories of a world's pedestrians, as in `map`."""
        return copy.deepcopy(self._people.on(self._layouts[world].map, world).pedestrians)

    def static_map(self, world: int) -> BridgeMap:
        """Return a copy of the map, without pedestrians."""
        whole = self._layouts[world].map
        return BridgeMap(whole.length, whole.half_width, whole.blocks.copy())

    def reset(self, ids: Ids, rngs: list[np.random.Generator]) -> None:
        """Place the rover at the start, and everything else at random."""
        self.simulation.reset(ids)
        if rngs:
            self._furnish(ids, [self._sample_episode(rng) for rng in rngs])
        self._begin(ids)

    def _furnish(self, ids: Ids, layouts: list[Layout]) -> None:
        for i, layout in zip(ids, layouts, strict=True):
            self._layouts[i], self._blocks[i] = layout, layout.map.blocks
        self._furniture.place(ids, layouts)
        self.rover.place(ids, layouts)
        self._people.begin(ids, layouts)

    def _begin(self, ids: Ids) -> None:
        self._time[ids] = 0.0
        self._people.reset(ids)
        self._move_walkers(ids)
        self.rover.begin(ids)
        self._action[ids] = 0.0
        self._distance[ids] = self.goal_x - self.rover.poses[ids, 0]
        self._update_state()

    def command(self, actions: Array) -> None:
        """Command linear and angular velocities (n, 2), m/s and rad/s."""
        self._action = actions
        self._distance = self.state.distance
        self.rover.command(actions)

    def advance(self, ids: Ids | None) -> None:
        """Simulate until the next control step, in worlds `ids` or in all."""
        times = np.tile(self._time, (1 + MOVES, 1))
        for moment in times[1:]:
            self._time[slice(None) if ids is None else ids] += CONTROL_PERIOD / MOVES
            moment[:] = self._time
        if self.options.walkers:
            places = self._people.walk(times, self.rover.poses, self.rover.velocities[:, 0])
            np.copyto(self._furniture.poses.positions, places)
        self.rover.drive(ids)
        self._people.note(self._time, self.rover.poses)

    def observation_parts(self) -> dict[str, NDArray[np.floating[Any]]]:
        """Return pose, velocity and own motion."""
        return {"pose": self.state.poses, "velocity": self.state.velocities, "motion": self._motion()}

    def observe(self, ids: Ids | None = None) -> Observations:
        """Return images `image` (n, height, width) and odometry `motion` (n, 3), or states (n, k)."""
        worlds = slice(None) if ids is None else ids
        if self._see is None:
            return self.state_observation(ids)
        if self.options.view == "image":
            return self._see(ids)
        part = "ranges" if self.options.view == "ranges" else "image"
        return {part: self._see(ids), "motion": self._motion().astype(np.float32)[worlds]}

    def state_observation(self, ids: Ids | None = None) -> NDArray[np.float32]:
        """Return pose, velocities, blocks and pedestrians (n, k)."""
        return full_state(self.state, self._blocks, self._people)[slice(None) if ids is None else ids]

    def perceived(self, numbers: NDArray[np.float32]) -> PerceivedBridges:
        """Return what policies that see the state read instead of this task, if its state has these numbers."""
        return PerceivedBridges(numbers, self.state, self.map, self.goal_x)

    def reward_terms(self) -> RewardTerms:
        """Return the terms of `BridgeOptions.reward`."""
        self._update_state()
        return {name: np.asarray(term(self.state), dtype=float) for name, term in self.reward_functions.items()}

    def outcome(self) -> NDArray[np.int8]:
        """Return `CROSSED`, `COLLIDED` or `FELL`; `TIMEOUT` while the episode goes on."""
        state = self.state
        return np.select(
            (state.fell, state.collided, state.crossed),
            (np.int8(BridgeOutcome.FELL), np.int8(BridgeOutcome.COLLIDED), np.int8(BridgeOutcome.CROSSED)),
            np.int8(BridgeOutcome.TIMEOUT),
        )

    def info(self) -> dict[str, Any]:
        """Return `contacts`: whether each part of the rover has touched each class of objects since the last step.

        `feasible`: whether the bridge can be crossed. It always can: `sample_layout` rejects other layouts.
        """
        touched = self.state.contacts
        return {
            "feasible": np.ones(len(touched), dtype=bool),
            "contacts": {
                part: {label: touched[:, i, j] for j, label in enumerate(CONTACT_CLASSES)}
                for i, part in enumerate(PARTS)
            },
        }

    def goal_distances(self) -> Array:
        """Return the distances (n,) m to the goal line; 0 beyond it."""
        return np.maximum(self.state.distance, 0.0)

    def motion(self) -> MotionSample:
        """Return the rovers' motion. Forbidden contacts are with barriers and obstacles, and of base and floor."""
        samples = None if self.joints is None else self.joints.since_last_step()
        return MotionSample(self.rover.positions.copy(), self.state.poses, self.state.collided, samples)

    def min_clearance(self, world: int, configurations: Array) -> float:
        """Return the least distance (m) of the turning disc from sides, blocks and people; negative in penetration."""
        bridge, points = self.map(world), configurations[:, :2]
        standing = np.linalg.norm(bridge.nearest(points) - points[:, None], axis=-1)
        times = CONTROL_PERIOD * np.arange(1, len(points) + 1)
        return min(float(standing.min()), self._people.closest(bridge, world, times, points)) - RADIUS

    def _sample_episode(self, rng: np.random.Generator) -> Layout:
        options = self.options
        return sample_layout(
            rng, options.deck_length, options.deck_width, options.blocks, options.walkers, options.missing_barriers
        )

    def _move_walkers(self, worlds: NDArray[np.int32]) -> None:
        if self.options.walkers:
            self._furniture.move_walkers(worlds, self._people.positions(self._time)[worlds])

    def _make_rover(self) -> PhysicalRover | PlanarRover:
        if self.options.dynamics == "physics":
            return PhysicalRover(self.simulation, self._furniture)
        return PlanarRover(self.simulation, self._furniture, self.options)

    def _make_camera(self) -> See | None:
        if self.options.view == "state":
            return None
        return self.rover.scan if isinstance(self.rover, PlanarRover) else make_camera(self.simulation, self.options)

    def _update_state(self) -> None:
        contacts = self.rover.contacts()
        label = {name: i for i, name in enumerate(CONTACT_CLASSES)}
        poses = self.rover.poses
        base_on_floor = contacts[:, PARTS.index("base"), label["floor"]]
        collided = contacts[:, :, (label["barrier"], label["obstacle"])].any(axis=(1, 2)) | base_on_floor
        beside = (np.abs(poses[:, 1]) > self.options.deck_width / 2) | (poses[:, 0] < 0)
        fell = (self.rover.wheel_heights < WHEEL_RADIUS / 2).any(axis=1) | (self.rover.upright < 0.5) | beside
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
        """Return odometry (m/s, rad/s) and the gyro's yaw rate (rad/s), (n, 3)."""
        return np.clip(np.column_stack((self.rover.odometry, self.rover.gyro[:, 2])), -FASTEST_MOTION, FASTEST_MOTION)


class BridgeMovingTask(BridgeTask):
    """The same, with pedestrians who walk across and along the bridge."""

    options_type: ClassVar[type[Any]] = BridgeMovingOptions
    instruction = "Drive across the bridge to the goal line, and avoid the barriers and the pedestrians."
    foresight = ("pedestrians",)
    default_policies = ("bridge_ompl", "bridge_mpc", "bridge_moving_imagined", "bridge_moving_distil", "random")
