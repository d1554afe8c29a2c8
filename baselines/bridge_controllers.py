"""Common part of the bridge experts: a policy with one controller per world, which sees the map and the true state."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armctl.control.arc_path import ArcPath
from armctl.control.drive_limits import DriveLimits
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.envs import Sees, TaskVectorEnv
from armctl.estimation.drive_observer import SLOW_TURN_RATE, DriveObserver, DriveResponse
from armctl.planning import PathPlannerOptions, plan_path
from armctl.robots.rover import MAX_VELOCITY
from armctl.scene import BridgeMap
from armctl.tasks import BridgeTask
from armctl.tasks.bridge import CONTROL_PERIOD

SHOWN_HEIGHT = 0.05
"""m: height above the deck at which plans are drawn."""
MAX_TURN_RATE, MAX_ACCELERATION, MAX_TURN_ACCELERATION = 2.5, 4.0, 10.0
"""rad/s, m/s^2, rad/s^2: limits of a rover of nominal response. It can accelerate and brake at 5.5."""
LIMIT_SHARE = 0.8
"""Share of a learned limit that is used."""
PROBED_ACCELERATION, PROBE = 4.1, np.array((1.0, 1.0, 1.0, -1.0, -1.0, -1.0))
"""m/s^2, below which a rover's turn rate is tried, and the commands for that, rad/s: a load and weak motors hardly let
it turn, slippery wheels do."""
PROBE_UNTIL = 1.5
"""s until which such a try may begin: later, a rover that was pushed would turn towards what it is beside."""
WEAK_TURN_RATE = 1.0
"""rad/s: the largest turn rate of a weak rover is less."""
MAP_TOLERANCE = 0.06
"""m or rad: changes of a map with noise for which another path is planned."""
SIZE_READINGS = 100
"""Number of the latest maps of which medians are taken."""
EXTRA_MARGIN = 0.05
"""m: added to distances if readings are noisy or the rover does not do what it should; the least gaps have as much."""
NARROW_CLEARANCE = 0.36
"""m from the rover's centre to anything, where a path leads through a gap that is too narrow for the usual one."""
SLOWEST = 0.85
"""m/s: speed of the weakest rover, for which it has just the time."""
FASTEST_PER_ACCELERATION, FASTEST_PER_TURN_RATE = 0.33, 2.5
"""s, m: speed per acceleration that is less than a nominal rover's, and per turn rate."""
FASTEST_TURN_PER_ACCELERATION = 0.7
"""s/m: turn rate per acceleration, whose limit slippery wheels have to the sides, too."""


class BridgeController(Protocol):
    """Crosses one bridge."""

    def act(self, pose: Array, velocity: Array, time: float) -> tuple[float, float]:
        """Return linear (m/s) and angular velocity (rad/s) for a pose (x, y, yaw), current velocities, and time (s)."""

    def see(self, bridge: BridgeMap) -> None:
        """Go by this map from now on: it is where things are believed to be, and noise may move them."""

    def plans(self) -> dict[str, Array]:
        """Return planned paths by name: lines of points (m, 2) m."""


class PreparedController(BridgeController, Protocol):
    """A controller that goes by what the rover can do."""

    def limit(self, limits: DriveLimits) -> None:
        """Keep these limits from now on."""


class PathFollower(Protocol):
    """A follower of one path."""

    path: ArcPath
    progress: float


def path_from(bridge: BridgeMap, position: Array, goal_x: float, margin: float = 0.0) -> Array:
    """Return corners (m, 2) m of a path to the goal line; (0, 2) if there is none, as off the free deck.

    It keeps `margin` (m) more from obstacles than usual if there is such a path near, and `NARROW_CLEARANCE` if no
    usual one exists.
    """
    on_deck = bridge.clearance(position[None])[0] > 0 and position[0] < goal_x
    options = PathPlannerOptions()
    wide = replace(options, clearance=options.clearance + margin, searches=options.searches[:2])
    narrow = replace(options, clearance=NARROW_CLEARANCE)
    for choice in ((wide, options, narrow) if margin else (options, narrow)) if on_deck else ():
        path = plan_path(bridge, position, goal_x, choice).path
        if len(path):
            return path
    return np.zeros((0, 2))


def distance_from_path(follower: PathFollower, pose: Array) -> float:
    """Return the distance (m) of a pose from the point of the path that a follower has reached."""
    return float(np.linalg.norm(follower.path.points_at(follower.progress) - pose[:2]))


def map_distance(first: BridgeMap, second: BridgeMap) -> float:
    """Return the largest difference (m or rad) of two maps' blocks."""
    return float(np.abs(first.blocks - second.blocks).max(initial=0.0))


def limits_of(response: DriveResponse, world: int, noisy: bool) -> DriveLimits:
    """Return what a rover of this response may do: weak and slippery ones drive slowly."""
    (linear, angular), turn_rate = response.acceleration[world].tolist(), float(response.speed[world, 1])
    speed = FASTEST_PER_TURN_RATE * turn_rate
    if linear >= PROBED_ACCELERATION:
        linear = MAX_ACCELERATION / LIMIT_SHARE
    else:
        speed = min(speed, FASTEST_PER_ACCELERATION * linear)
    return DriveLimits(
        max_speed=float(np.clip(speed, SLOWEST, MAX_VELOCITY[0])),
        max_turn_rate=min(MAX_TURN_RATE, turn_rate, FASTEST_TURN_PER_ACCELERATION * linear),
        max_acceleration=min(MAX_ACCELERATION, LIMIT_SHARE * linear),
        max_turn_acceleration=min(MAX_TURN_ACCELERATION, LIMIT_SHARE * angular),
        margin=EXTRA_MARGIN if noisy or linear < PROBED_ACCELERATION or turn_rate < WEAK_TURN_RATE else 0.0,
    )


class BridgePolicy:
    """A policy of controllers, each made for a map and the goal line's x (m).

    `prepared` controllers act from the state in which their commands will act, and within limits that are learned; maps
    with noise are averaged. They are `PreparedController`.
    """

    sees: Sees = "state"
    training_steps = 0

    def __init__(
        self,
        name: str,
        env: TaskVectorEnv,
        make_one: Callable[[BridgeMap, float], BridgeController],
        prepared: bool = False,
    ) -> None:
        if not isinstance(env.task, BridgeTask):
            raise ConfigurationError(f"{name} cannot play this task: use it with armctl/BridgeCross-v0")
        self._env, self._make_one, self.prepared = env, make_one, prepared
        self._controllers: list[Any] = [None] * env.num_envs
        self._failed_before = np.zeros(env.num_envs, dtype=np.int64)
        self._observer = DriveObserver(env.num_envs) if prepared else None
        self._probes = np.zeros(env.num_envs, dtype=np.int64)
        self._maps = [MapAverage() for _ in range(env.num_envs)]

    @property
    def failures(self) -> NDArray[np.int64]:
        """(n,) number of solver failures in each world; 0 for controllers that do not count them."""
        counts = [getattr(controller, "failures", 0) for controller in self._controllers]
        return np.add(self._failed_before, counts, dtype=np.int64)

    def plans(self, world: int) -> dict[str, Array]:
        """Return the plans of a world's controller: lines of points (m, 3) m, just above the deck."""
        controller = self._controllers[world]
        lines = controller.plans() if controller else {}
        return {name: np.column_stack((points, np.full(len(points), SHOWN_HEIGHT))) for name, points in lines.items()}

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Make new controllers for worlds `ids`, which have new maps."""
        if self._observer:
            self._observer.reset(ids)
        self._probes[ids] = 0
        for i in ids:
            self._failed_before[i] += getattr(self._controllers[i], "failures", 0)
            self._maps[i] = MapAverage()
            self._controllers[i] = self._make_one(self._env.perceived().map(i), self._env.task.goal_x)

    def act(self, observations: Any) -> Array:
        """Return linear and angular velocities (n, 2), m/s and rad/s."""
        perceived = self._env.perceived()
        noisy = perceived is not self._env.task
        if noisy or self._env.task.options.pedestrians == "reactive":
            for i, controller in enumerate(self._controllers):
                if controller:
                    bridge = perceived.map(i)
                    controller.see(self._maps[i].with_map(bridge) if self._observer and noisy else bridge)
        state = perceived.state
        if self._observer:
            return self._act_prepared(
                self._observer, np.column_stack((state.poses, state.velocities)), state.time, noisy
            )
        states = zip(self._controllers, state.poses, state.velocities, state.time, strict=True)
        return np.array([controller.act(*values) if controller else (0.0, 0.0) for controller, *values in states])

    def _act_prepared(self, observer: DriveObserver, states: Array, times: Array, noisy: bool) -> Array:
        ahead, velocities = observer.observe(states, noisy), np.zeros((len(states), 2))
        times = times + CONTROL_PERIOD * observer.delay
        for i, controller in enumerate(self._controllers):
            if controller:
                controller.limit(limits_of(observer.response, i, noisy))
                velocities[i] = controller.act(ahead[i, :3], ahead[i, 3:], times[i])
        weak = (observer.response.acceleration[:, 0] < PROBED_ACCELERATION) & (times < PROBE_UNTIL) | (self._probes > 0)
        weak &= (self._probes < len(PROBE)) & (observer.response.speed[:, 1] >= SLOW_TURN_RATE)
        velocities[weak, 1] = PROBE[self._probes[weak]]
        self._probes[weak] += 1
        return observer.command(velocities)


class MapAverage:
    """Mean of the maps of one bridge that were seen: all but the pedestrians' phases stands still.

    Sizes and yaws are medians: where a reading is cut off at the largest possible value, the mean is too small.
    """

    def __init__(self) -> None:
        self._count = 0
        self._means: list[Array] = []
        self._sizes: deque[Array] = deque(maxlen=SIZE_READINGS)

    def with_map(self, bridge: BridgeMap) -> BridgeMap:
        """Return the mean of this map and all before."""
        walkers = bridge.pedestrians
        readings = bridge.blocks[:, :2], walkers.start, walkers.end
        self._count += 1
        means = self._means or readings
        self._means = [mean + (new - mean) / self._count for mean, new in zip(means, readings, strict=True)]
        self._sizes.append(bridge.blocks[:, 2:])
        centres, start, end = self._means
        blocks = np.column_stack((centres, np.median(self._sizes, axis=0)))
        return replace(bridge, blocks=blocks, pedestrians=walkers.moved_to(start, end))
