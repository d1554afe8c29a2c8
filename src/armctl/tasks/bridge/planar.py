"""The bridge without physics: a rover that follows its commands within limits of acceleration, drawn from above.

It is for training: far faster than MuJoCo (`benchmarks/planar.py`), and near enough that learned agents work in both.
Wheels do not skid, nothing topples, and the rover stops at the first contact.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels import planar as kernel
from armctl.robots.rover import CAMERA, MAX_VELOCITY, PARTS, PREFIX, WHEEL_RADIUS, WHEELS, Rover
from armctl.simulation import Simulation
from armctl.tasks.bridge.furniture import Furniture
from armctl.tasks.bridge.layout import Layout, turning_y
from armctl.tasks.bridge.observation import camera_pitch, column_directions
from armctl.tasks.bridge.options import CONTROL_PERIOD, BridgeOptions
from armctl.tasks.bridge.world import CONTACT_CLASSES, GOAL_MARGIN, free_half_width, segment_names
from armctl.tasks.task import Ids

LINEAR_ACCELERATION, ANGULAR_ACCELERATION = 6.0, 12.0
"""m/s^2 and rad/s^2: what MuJoCo's rover does on the asphalt, rounded."""
MARGIN = 0.02
"""m: by so much more than in physics, rovers keep away from everything: wheels that skid take them a little farther."""
SEEN_BEHIND_FOOT = 0.02
"""m: so far behind a barrier's foot is, just above it, the convex hull that MuJoCo makes of the barrier."""
FARTHEST_HOLE = 2.5
"""m: holes in the deck are seen up to this distance."""


@dataclass(frozen=True)
class Geometry:
    """The sizes of bridges and rovers."""

    deck: kernel.Deck
    blocks: int
    """Number of blocks on each bridge."""
    segments: int
    """Jersey barriers on each side."""
    turn: float
    """m from the middle of the deck, at which people who walk across turn back."""
    goal_x: float
    """m: a rover has crossed when one of its wheels is there."""
    wheels: Array
    """(4, 2) m from the rover's middle: ahead and to the left."""
    rover: kernel.Rover
    """Rover with an outline of base and wheels, and `MARGIN` around them."""

    @classmethod
    def of(cls, options: BridgeOptions, model: mujoco.MjModel) -> "Geometry":
        """Return the geometry of a bridge's model."""
        half_width = free_half_width(options.deck_width)
        wheels = np.array([model.body(PREFIX + name).pos[:2] for name in WHEELS])
        base, wheel = model.geom(PREFIX + "base").size[:2], model.geom(PREFIX + WHEELS[0]).size[:2]
        return cls(
            kernel.Deck(options.deck_length, half_width, options.walker_radius, options.deck_width / 2),
            options.blocks,
            len(segment_names(options.deck_length)) // 2,
            turning_y(half_width),
            options.deck_length - GOAL_MARGIN - model.geom("goal_line").size[0],
            wheels,
            kernel.Rover(
                LINEAR_ACCELERATION, ANGULAR_ACCELERATION, np.array([base, wheels.max(axis=0) + wheel]) + MARGIN
            ),
        )

    def wheel_positions(self, poses: Array) -> Array:
        """Return (n, 4, 2) m, of rovers at poses (n, 3)."""
        cos, sin = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
        ahead, left = self.wheels.T
        turned = np.stack((ahead * cos - left * sin, ahead * sin + left * cos), axis=-1)
        return np.asarray(poses[:, None, :2] + turned)

    def wheels_at_goal(self, poses: Array) -> NDArray[np.bool_]:
        """Return which wheels of rovers at poses (n, 3) have got to the goal line, (n, 4)."""
        return np.asarray(self.wheel_positions(poses)[..., 0] >= self.goal_x)


def block_rows(blocks: Array) -> Array:
    """Return blocks (n, k, 5), as a `BridgeMap` has them, as the kernel's rows (n, k, 6)."""
    places, yaws, sizes = np.split(blocks, (2, 3), axis=-1)
    return np.concatenate((places, np.cos(yaws), np.sin(yaws), sizes), axis=-1)


class PlanarRover(Rover):
    """n rovers without physics. Their poses are in the simulation's `qpos`, where pictures find them."""

    joints = rollout_worlds = None

    def __init__(self, simulation: Simulation, furniture: Furniture, options: BridgeOptions) -> None:
        super().__init__(simulation)
        n, self._furniture, self._options = simulation.n, furniture, options
        self._walkers = walkers = furniture.poses.positions
        self._rovers = kernel.Rovers(np.zeros((n, 3)), np.zeros((n, 2)), np.zeros(n, dtype=np.int64))
        self._poses, self._velocities, self._touched = self._rovers
        self._commands = np.zeros((n, 2))
        self._geometry = geometry = Geometry.of(options, simulation.model)
        self._scenes = kernel.Scenes(
            np.zeros((n, options.blocks, 6)), np.ones((n, 2, geometry.segments), dtype=bool), walkers[-1]
        )
        model = simulation.model
        deck = geometry.deck
        self._sensor = kernel.RangeSensor(
            model.camera(CAMERA).pos[0], column_directions(options, camera_pitch(model)),
            deck.half_width + SEEN_BEHIND_FOOT, options.camera_range, FARTHEST_HOLE,
        )  # fmt: skip
        self._worlds = np.arange(n, dtype=np.int32)

    def place(self, ids: Ids, layouts: list[Layout]) -> None:
        """Put blocks and barriers of worlds `ids` where their layouts have them."""
        self._scenes.blocks[ids] = block_rows(np.stack([layout.map.blocks for layout in layouts]))
        missing = np.stack([layout.missing for layout in layouts])
        self._scenes.barriers[ids] = True
        self._scenes.barriers[ids[:, None], missing % 2, missing // 2] = False

    def begin(self, ids: Ids) -> None:
        """Begin episodes of rovers `ids`, which stand where the simulation has put them."""
        self._poses[ids] = super().poses[ids]
        self._velocities[ids] = self._commands[ids] = 0.0
        self._touched[ids] = kernel.FREE

    def command(self, velocities: Array) -> None:
        """Set linear and angular velocities (n, 2), m/s and rad/s, clipped to `MAX_VELOCITY`."""
        self._commands = np.clip(velocities, -MAX_VELOCITY, MAX_VELOCITY)

    def drive(self, ids: Ids | None) -> None:
        """Drive for one control step, in worlds `ids` or in all."""
        ids, sizes = self._worlds if ids is None else ids, self._geometry
        kernel.drive(
            ids, sizes.deck, self._scenes, sizes.rover, self._walkers, CONTROL_PERIOD, self._commands, self._rovers
        )
        self._furniture.move_walkers(self._worlds, self._walkers[-1])
        x, y, yaw = self._poses.T
        first = self._pose_columns.start
        self._qpos[:, first], self._qpos[:, first + 1] = x, y
        self._qpos[:, first + 3], self._qpos[:, first + 6] = np.cos(yaw / 2), np.sin(yaw / 2)

    def scan(self, ids: Ids | None) -> NDArray[np.float32]:
        """Return ranges (n, columns) from the camera, m, in the directions of its image's columns at the horizon."""
        ids = self._worlds if ids is None else ids
        ranges = np.empty((len(ids), len(self._sensor.directions)), dtype=np.float32)
        kernel.scan(ids, self._geometry.deck, self._scenes, self._sensor, self._poses, ranges)
        return ranges

    def contacts(self) -> NDArray[np.bool_]:
        """Return contacts since the last control step, (n, `PARTS`, `CONTACT_CLASSES`): collisions are the base's."""
        classes = list(CONTACT_CLASSES)
        contacts = np.zeros((len(self._poses), len(PARTS), len(classes)), dtype=bool)
        contacts[:, 1:, classes.index("floor")] = True
        contacts[:, 0, classes.index("barrier")] = self._touched == kernel.BARRIER
        contacts[:, 0, classes.index("obstacle")] = self._touched == kernel.OBSTACLE
        contacts[:, 1:, classes.index("goal")] = self._geometry.wheels_at_goal(self._poses)
        return contacts

    @property
    def poses(self) -> Array:
        """x, y (m) and yaw (rad), (n, 3)."""
        return self._poses.copy()

    @property
    def positions(self) -> Array:
        """Positions of the bases, (n, 3) m."""
        return np.column_stack((self._poses[:, :2], np.full(len(self._poses), WHEEL_RADIUS)))

    @property
    def velocities(self) -> Array:
        """Forward velocity (m/s) and yaw rate (rad/s), (n, 2)."""
        return self._velocities.copy()

    @property
    def odometry(self) -> Array:
        """Linear (m/s) and angular velocity (rad/s), (n, 2): wheels that speed up are ahead of the rover."""
        return (self._velocities + self._commands) / 2

    @property
    def gyro(self) -> Array:
        """Angular velocity, (n, 3) rad/s."""
        rates = np.zeros((len(self._poses), 3))
        rates[:, 2] = self._velocities[:, 1]
        return rates

    @property
    def wheel_heights(self) -> Array:
        """Heights of the wheel centres, (n, 4) m: 0 beyond the edges of the deck."""
        beside = np.abs(self._geometry.wheel_positions(self._poses)[..., 1]) > self._options.deck_width / 2
        return np.where(beside, 0.0, WHEEL_RADIUS)
