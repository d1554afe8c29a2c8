"""A floor on the bridge: pure pursuit along the straight line to the goal, that stops for what it sees ahead.

Coulter, "Implementation of the pure pursuit path tracking algorithm", CMU-RI-TR-92-01, 1992. It passes nothing: where a
block stands on the line, it waits until the time is up. It reckons its pose from wheels and gyro, and sees by the depth
camera.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from armctl.baselines.bridge_view import BridgeView
from armctl.control import PursuitOptions, RegulatedPurePursuit
from armctl.core.arrays import Array
from armctl.core.options import NonNegative, Positive, changed_options, options
from armctl.envs import ModelInterface
from armctl.policies import PerWorld, made_for, sees
from armctl.robots.rover import RADIUS


@options
class BridgePursuitOptions:
    """Options of `bridge_pursuit`."""

    speed: Positive = 1.0
    """m/s."""
    stop_distance: NonNegative = 0.7
    """m before the rover's front in which anything makes it stop."""
    margin: NonNegative = 0.05
    """m beside the rover that must be free as well."""


@made_for("armctl/BridgeCross* armctl/BarnCross*", controls="rover")
@sees("model", family="pure pursuit")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """Pure pursuit along the straight line to the goal; stops for what it sees ahead."""
    checked = changed_options(BridgePursuitOptions(), options, "option of bridge_pursuit")
    return PerWorld([BridgePursuit(BridgeView("bridge_pursuit", env), checked) for _ in range(env.num_envs)])


class BridgePursuit:
    """Crosses one bridge."""

    def __init__(self, view: BridgeView, options: BridgePursuitOptions) -> None:
        self._view, self._options = view, options
        self.reset()

    def reset(self) -> None:
        """Draw the line from the start to the goal."""
        self._view.reset()
        self._line = np.array((self._view.pose[:2], (self._view.goal_x, 0.0)))
        self._pursuit = RegulatedPurePursuit(self._line, PursuitOptions(max_speed=self._options.speed))

    def plans(self) -> dict[str, Array]:
        """Return the line, (2, 3) m."""
        return {"path": np.column_stack((self._line, np.zeros(2)))}

    def act(self, observation: Mapping[str, Any]) -> Array:
        """Return linear (m/s) and angular velocity (rad/s)."""
        self._view.update(observation)
        ahead, sideways = self._view.ahead.T
        in_the_way = (np.abs(sideways) < RADIUS + self._options.margin) & (ahead < RADIUS + self._options.stop_distance)
        if in_the_way.any():
            return np.zeros(2)
        return np.array(self._pursuit.command(self._view.pose, float(self._view.velocity[0])))
