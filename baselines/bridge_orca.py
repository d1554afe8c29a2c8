"""A floor among people: velocity obstacles, around people who are thought to walk straight on.

Optimal reciprocal collision avoidance (van den Berg et al., "Reciprocal n-body collision avoidance", 2011): each person
forbids a half-plane of velocities, and the rover takes the velocity nearest to that of its pursuit of OMPL's path among
the rest. It takes the whole responsibility, as people do not give way. A point before the rover moves in any direction
(Snape et al., "Smooth and collision-free navigation for multiple robots under differential-drive constraints", IROS
2010), so discs are larger by that. It sees the state: blocks, and people's present positions and velocities.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.bridge_controllers import distance_from_path, path_from
from armctl.control import RegulatedPurePursuit
from armctl.control.velocity_obstacles import avoidance, nearest_velocity
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import NonNegative, Positive, Share, changed_options, options
from armctl.envs import Sees, TaskVectorEnv
from armctl.policies import made_for, sees
from armctl.robots.rover import MAX_VELOCITY, RADIUS
from armctl.tasks import BridgeTask
from armctl.tasks.bridge import CONTROL_PERIOD
from armctl.tasks.bridge.observation import BLOCK, ROVER, WALKER

REPLAN_DISTANCE = 0.4
"""m: distance from the path at which a new one is planned."""
SIDES = np.array([(np.cos(angle), np.sin(angle)) for angle in np.arange(8) * np.pi / 4])
"""Normals of the octagon that bounds speeds."""


@options
class BridgeOrcaOptions:
    """Options of `bridge_orca`."""

    offset: Positive = 0.15
    """m from the rover's centre to the point that moves in any direction."""
    horizon: Positive = 2.0
    """s for which it keeps clear of people."""
    static_horizon: Positive = 0.4
    """s for which it keeps clear of blocks and barriers."""
    margin: NonNegative = 0.05
    """m between the rover and people."""
    responsibility: Share = 1.0
    """Share of the avoidance that is the rover's: 0.5 among people who take the other half."""


@made_for("armctl/BridgeCross* armctl/BarnCross*", controls="rover")
@sees("state", family="velocity obstacles")
def make(env: TaskVectorEnv, options: Mapping[str, Any] = MappingProxyType({})) -> "BridgeOrca":
    """OMPL path on the true map, and velocity obstacles (ORCA) for people, by their present velocities."""
    return BridgeOrca(env, changed_options(BridgeOrcaOptions(), options, "option of bridge_orca"))


class BridgeOrca:
    """Crosses n bridges."""

    sees: Sees = "state"
    training_steps = 0

    def __init__(self, env: TaskVectorEnv, options: BridgeOrcaOptions) -> None:
        if not isinstance(env.task, BridgeTask):
            raise ConfigurationError("bridge_orca cannot play this task: use it with armctl/BridgeCross-v0")
        self._env, self._options = env, options
        self._pursuits: list[RegulatedPurePursuit | None] = [None] * env.num_envs

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Forget the paths of worlds `ids`."""
        for i in ids:
            self._pursuits[i] = None

    def act(self, observations: Any) -> Array:
        """Return linear and angular velocities (n, 2), m/s and rad/s."""
        numbers = np.asarray(self._env.perceived().state_observation(), dtype=float)
        return np.array([self._act_in(world, state) for world, state in enumerate(numbers)])

    def _act_in(self, world: int, state: Array) -> Array:
        task = self._env.task
        (x, y, cos, sin, *velocity), blocks, people = np.split(state, (ROVER, ROVER + BLOCK * task.options.blocks))
        bridge = replace(task.static_map(world), blocks=blocks.reshape(-1, BLOCK).clip((-np.inf,) * 3 + (0.0, 0.0)))
        pose, pursuit = np.array((x, y, np.arctan2(sin, cos))), self._pursuits[world]
        if pursuit is None or distance_from_path(pursuit, pose) > REPLAN_DISTANCE:
            if not len(path := path_from(bridge, pose[:2], task.goal_x)):
                return np.zeros(2)
            pursuit = self._pursuits[world] = RegulatedPurePursuit(path)
        options = self._options
        to_velocity = np.array(((cos, -sin), (sin, cos))) * (1.0, options.offset)  # of the point, from the command
        point, present = pose[:2] + options.offset * np.array((cos, sin)), to_velocity @ velocity
        to_static = bridge.nearest(point[None])[0] - point
        distances = np.linalg.norm(to_static, axis=1)
        normals = [*(-to_static / np.maximum(distances, 1e-6)[:, None]), *-SIDES]
        room = np.maximum(distances - RADIUS, 0.0) / options.static_horizon
        bounds = [*-room, *np.full(len(SIDES), -MAX_VELOCITY[0])]
        soft, radius = len(bounds), RADIUS + options.offset + task.options.walker_radius + options.margin
        for person in people.reshape(-1, WALKER):
            offset, relative = person[:2] - point, present - person[2:]
            change, normal = avoidance(offset, relative, radius, options.horizon, CONTROL_PERIOD)
            normals.append(normal)
            bounds.append(normal @ (present + options.responsibility * change))
        preferred = to_velocity @ pursuit.command(pose, velocity[0])
        best = nearest_velocity(preferred, np.array(normals), np.array(bounds), np.arange(len(bounds)) >= soft)
        return np.clip(np.linalg.solve(to_velocity, best), -MAX_VELOCITY, MAX_VELOCITY)
