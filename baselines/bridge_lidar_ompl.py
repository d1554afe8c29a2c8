"""An expert that crosses by its sensors alone: depth camera and odometry. It sees neither the map nor its true pose.

Each picture is reduced to what stands in each column. The barriers beside the deck correct the dead-reckoned pose; all
else that stands goes into an occupancy grid, and what is taller than a block is a person, who is tracked. OMPL plans
around boxes about the occupied cells, and MPC follows, past the people as they would walk on. Through lost pictures, it
goes by what it remembers.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.bridge_controllers import limits_of
from armctl.control.arc_path import ArcPath
from armctl.control.drive_mpc import DriveMpc, DriveMpcOptions
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, NonNegative, Positive, changed_options, options
from armctl.envs import ModelInterface
from armctl.estimation.corridor_localization import Corridor, CorridorLocalization
from armctl.estimation.depth_ranges import DepthCamera
from armctl.estimation.depth_scan import CameraMount, DepthScan, DepthScanner
from armctl.estimation.drive_observer import DriveObserver
from armctl.estimation.occupancy_grid import OccupancyGrid
from armctl.estimation.tracking import PeopleTracker, TrackerOptions
from armctl.planning.bridge_planner import PathPlannerOptions, plan_path
from armctl.policies import PerWorld, made_for, sees
from armctl.robots.rover import (
    CAMERA_AHEAD,
    CAMERA_PITCH,
    MAX_WHEEL_SPEED,
    RADIUS,
    TRACK,
    WHEEL_RADIUS,
    WHEEL_SEPARATION_MULTIPLIER,
)
from armctl.scene import BridgeMap, PedestrianTrajectories
from armctl.tasks.bridge import CONTROL_PERIOD, BridgeOptions
from armctl.tasks.bridge.world import START_X, free_half_width

CAMERA = CameraMount(ahead=CAMERA_AHEAD, above=0.302, lift=0.31)
BARRIER_LEAN, BARRIER_FOOT = 0.313, 0.075
"""Jersey barriers lean outwards by so many m per m above the foot, m."""
SLIDE, ROLLING, EARLY = 0.068, 0.975, 0.8
"""The rover slides outwards in turns, s; its speed relative to that of its wheels' rims; and the weight of the velocity
at the end of a control step, relative to that at its beginning, as changes are quick."""
NOISY, NOISE_SHARE = 0.02, 0.1
"""m: noise of depths from which on all readings are filtered; weight of a picture in its estimate."""
BEYOND = 3.0
"""m: so much longer than the deck is the believed map, as the position along it is only dead-reckoned."""
BARRIER_BAND = 0.12
"""m from the barriers within which points are of these."""
CLEARANCES = (0.5, 0.45, 0.4, 0.35)
"""m to keep from obstacles: the largest with which there is a path."""
BLOCKED = RADIUS + 0.02
"""m: a path that comes nearer to an obstacle is planned anew."""
LOOK_AHEAD = 8.0
"""m of the path that are checked against new obstacles."""
AROUND_PERSON = 0.15
"""m around a person, in which all that is seen is the person."""
LANE = 1.5
"""m: so far, both ways, people who walk along the bridge are expected."""
SHOWN_HEIGHT = 0.05
"""m: height above the deck at which plans are drawn."""


@options
class BridgeLidarOmplOptions:
    """Options of `bridge_lidar_ompl`."""

    max_speed: Positive = 1.7
    """m/s."""
    acceleration: Positive = 4.0
    """m/s^2."""
    margin: NonNegative = 0.08
    """m: distance between the rover and obstacles."""
    people_margin: NonNegative = 0.15
    """m: distance between the rover and people."""
    replan_steps: Count = 5
    """Control steps after which the path is planned anew in any case."""


@made_for("armctl/BridgeCross* armctl/BarnCross*", controls="rover")
@sees("model", family="OMPL")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """OMPL paths over a map of what its depth camera saw, and MPC along them, past the people that it tracks."""
    checked, task = changed_options(BridgeLidarOmplOptions(), options, "option of bridge_lidar_ompl"), env.options
    if not isinstance(task, BridgeOptions):
        raise ConfigurationError("bridge_lidar_ompl cannot play this task: use it with armctl/BridgeCross-v0")
    if (task.view, task.camera, task.image_format) != ("camera", "depth", "float"):
        raise ConfigurationError("bridge_lidar_ompl reads a depth image in m, and the rover's own motion")
    return PerWorld([BridgeLidarOmpl(task, checked) for _ in range(env.num_envs)], "model")


class BridgeLidarOmpl:
    """Crosses bridges, one after the other."""

    def __init__(self, task: BridgeOptions, options: BridgeLidarOmplOptions) -> None:
        width, height = task.size
        camera = DepthCamera(height, width, task.field_of_view, task.camera_range, CAMERA_PITCH)
        self._scanner, self._settings = DepthScanner(camera, CAMERA), options
        self._half_width, self._length = free_half_width(task.deck_width), task.deck_length + BEYOND
        self._radius = task.walker_radius
        self._turn = self._half_width - self._radius - 0.05
        self._options = DriveMpcOptions(
            max_speed=options.max_speed,
            max_acceleration=options.acceleration,
            max_rim_speed=MAX_WHEEL_SPEED * WHEEL_RADIUS,
            half_track=TRACK * WHEEL_SEPARATION_MULTIPLIER / 2,
            clearance=RADIUS + options.margin,
            distance=RADIUS + self._radius + options.people_margin,
            period=CONTROL_PERIOD,
        )
        self._clock = CONTROL_PERIOD * np.arange(self._options.steps + 1)
        self._failed_before = 0
        self._mpc: DriveMpc | None = None
        self.reset()

    @property
    def failures(self) -> int:
        """Control steps without a solution, in which the rover braked."""
        return self._failed_before + (self._mpc.failures if self._mpc else 0)

    def plans(self) -> dict[str, Array]:
        """Return the path and the predicted positions of the rover, (m, 3) m, where it believes to be."""
        return {
            name: np.pad(line, ((0, 0), (0, 1)), constant_values=SHOWN_HEIGHT) for name, line in self._plans.items()
        }

    def reset(self) -> None:
        """Begin on a new bridge, of which nothing is known."""
        self._failed_before = self.failures
        corridor = Corridor(self._half_width, BARRIER_LEAN, BARRIER_FOOT)
        self.localization = CorridorLocalization((START_X, 0.0, 0.0), corridor, SLIDE)
        self.grid = OccupancyGrid((0.0, -self._half_width), (self._length, self._half_width))
        self.tracker = PeopleTracker(TrackerOptions(period=CONTROL_PERIOD, radius=self._radius, turn=self._turn))
        self.bridge = BridgeMap(self._length, self._half_width, np.zeros((0, 5)))
        self.observer = DriveObserver(1)
        self._mpc = None
        self._plans: dict[str, Array] = {}
        self._velocity, self._steps, self._noise = np.zeros(2), 0, 0.0

    def act(self, observation: Mapping[str, Array]) -> Array:
        """Return linear and angular velocity for a depth image (height, width), m, and odometry and gyro (3,)."""
        self._reckon(observation["motion"])
        self.tracker.predict()
        scan = self._scanner.scan(observation["image"])
        if scan is not None:
            self._observe(scan)
        self.bridge = BridgeMap(self._length, self._half_width, self.grid.boxes(), self._people())
        state = np.concatenate((self.localization.pose, self._velocity))[None]
        ahead = self.observer.observe(state, noisy=self._noise > NOISY)[0]
        return np.asarray(self.observer.command(np.array((self._drive(ahead),)))[0])

    def _reckon(self, motion: Array) -> None:
        """Move the believed pose by the velocities now and a control step ago."""
        velocity = np.where(np.isfinite(motion[[0, 2]]), motion[[0, 2]] * (ROLLING, 1.0), self._velocity)
        if self._steps:
            mean = EARLY * velocity + (1 - EARLY) * self._velocity
            self.localization.predict(float(mean[0]), float(mean[1]), CONTROL_PERIOD)
        self._velocity = velocity
        self._steps += 1

    def _observe(self, scan: DepthScan) -> None:
        """Correct pose, people and map by a picture."""
        localization, camera = self.localization, self._scanner.camera
        self._noise += NOISE_SHARE * (scan.noise - self._noise)
        visible = np.isfinite(scan.standing).all(axis=1)
        is_still = visible & np.isnan(scan.tall[:, 0])
        is_still &= ~self._is_person(localization.in_world(scan.standing))
        localization.correct(scan.standing[is_still], scan.heights[is_still])
        standing, tall = localization.in_world(scan.standing), localization.in_world(scan.tall)
        mount = np.array((CAMERA.ahead, 0.0))
        origin = localization.in_world(mount)
        directions = localization.in_world(mount + camera.directions) - origin
        inside = visible & (np.abs(standing[:, 1]) < self._half_width - BARRIER_BAND)
        unknown = np.where((inside & ~self.grid.near_occupied(standing))[:, None], standing, np.nan)
        self.tracker.update(origin, tall, unknown, origin + scan.free[:, None] * directions)
        is_obstacle = inside & ~self._is_person(standing)
        self.grid.add(origin, directions, scan.free, is_obstacle)
        self.grid.forget(self.tracker.tracks.positions, self._radius)

    def _is_person(self, points: Array) -> NDArray[np.bool_]:
        """Return which of points (m, 2) are at tracked people."""
        offsets = points[:, None] - self.tracker.tracks.positions
        return np.asarray((np.linalg.norm(offsets, axis=-1) < self._radius + AROUND_PERSON).any(axis=1))

    def _people(self) -> PedestrianTrajectories:
        """Return tracked people as they walk on from now, straight across the deck or along it."""
        tracks, turn = self.tracker.tracks, self._turn
        (x, y), (vx, vy) = tracks.positions.T, tracks.velocities.T
        y, across = np.clip(y, -turn, turn), np.abs(vy) > np.abs(vx)
        start = np.column_stack((np.where(across, x, x - LANE), np.where(across, -turn, y)))
        end = np.column_stack((np.where(across, x, x + LANE), np.where(across, turn, y)))
        length, walked = 2 * np.where(across, turn, LANE), np.where(across, y + turn, LANE)
        phase = np.where(np.where(across, vy, vx) > 0, walked, 2 * length - walked)
        return PedestrianTrajectories(start, end, np.where(across, np.abs(vy), np.abs(vx)), phase, self._radius)

    def _drive(self, state: Array) -> tuple[float, float]:
        """Return the velocities for the state in which they will act."""
        self._plan(state[:2])
        if self._mpc is None:
            return 0.0, 0.0
        self._mpc.limit(limits_of(self.observer.response, 0, noisy=False))  # its margin has room for noise
        people = self.bridge.pedestrians.positions(CONTROL_PERIOD * self.observer.delay[0] + self._clock)
        result = self._mpc.decide(state[:3], state[3:], people)
        self._plans["horizon"] = result.poses[:, :2]
        return result.command

    def _plan(self, position: Array) -> None:
        """Plan a path if there is none, if the last one is blocked, and from time to time."""
        if self._mpc and self._steps % self._settings.replan_steps and not self._is_blocked(self._mpc):
            return
        goal_x = self._length - BEYOND / 2
        if self.bridge.clearance(position[None])[0] <= 0 or position[0] >= goal_x:
            return
        for clearance in CLEARANCES:
            options = PathPlannerOptions(clearance=clearance, searches=(0, 100))
            path = plan_path(self.bridge, position, goal_x, options).path
            if len(path):
                self._mpc = self._mpc or DriveMpc(path, lambda points: self.bridge.nearest(points), self._options)
                self._mpc.path, self._mpc.progress, self._plans["path"] = ArcPath(path), 0.0, path
                return

    def _is_blocked(self, mpc: DriveMpc) -> bool:
        arcs = mpc.progress + np.arange(0.5, LOOK_AHEAD, 0.1)
        points = mpc.path.points_at(arcs[arcs < mpc.path.length])
        return bool((self.bridge.with_lanes_blocked().clearance(points) < BLOCKED).any())
