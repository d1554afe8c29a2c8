"""Dead reckoning and obstacles ahead, from a depth camera, wheels and gyro alone."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from armctl.core.errors import ConfigurationError
from armctl.envs import ModelInterface
from armctl.estimation.depth_ranges import DepthCamera
from armctl.robots.rover import CAMERA_AHEAD, CAMERA_PITCH
from armctl.tasks import BridgeOptions
from armctl.tasks.bridge import CONTROL_PERIOD
from armctl.tasks.bridge.world import START_X, free_half_width

BEYOND = 2.0
"""m beyond the deck's end to which it drives: reckoned poses get ahead of the true ones, as wheels slip."""


class BridgeView:
    """Pose and obstacles of one rover, from one observation after another; readings that are not numbers are ignored.

    Raises `ConfigurationError` for an environment whose observation has neither depths nor ranges.
    """

    def __init__(self, name: str, env: ModelInterface) -> None:
        options = env.options
        if not isinstance(options, BridgeOptions):
            raise ConfigurationError(f"{name} cannot play this task: use it with armctl/BridgeCross-v0")
        depths = (options.view, options.camera, options.image_format) == ("camera", "depth", "float")
        if options.view != "ranges" and not depths:
            raise ConfigurationError(f"{name} reads a depth image in m or ranges, and the rover's own motion")
        width, height = options.size
        self.camera = DepthCamera(height, width, options.field_of_view, options.camera_range, CAMERA_PITCH)
        self.goal_x, self.half_width = options.deck_length + BEYOND, free_half_width(options.deck_width)
        self._half_view = float(np.arctan2(*self.camera.directions[0][::-1]))
        self.reset()

    def reset(self) -> None:
        """Begin at the start of a bridge, where nothing has been seen."""
        self.pose = np.array((START_X, 0.0, 0.0))
        """x, y (m) and yaw (rad) by dead reckoning."""
        self.velocity = np.zeros(2)
        """Forward velocity (m/s) and yaw rate (rad/s)."""
        self.ahead = self.obstacles = np.zeros((0, 2))
        """(k, 2) m: points ahead and to the left of the rover's centre at which obstacles or holes begin, as seen now;
        and all that are remembered, by x and y."""
        self._ages = np.zeros(0)
        self._started = False

    def update(self, observation: Mapping[str, Any], memory: float = 0.0) -> None:
        """Take in an observation; what is out of view is remembered for `memory` s."""
        self._reckon(observation["motion"])
        ranges = observation["ranges"] if "ranges" in observation else self.camera.ranges(observation["image"])
        ranges = np.asarray(ranges, dtype=float)
        hits = np.isfinite(ranges) & (ranges < self.camera.farthest)
        self.ahead = ranges[hits, None] * self.camera.directions[hits] + (CAMERA_AHEAD, 0.0)
        x, y, yaw = self.pose
        turn = np.array(((math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))))
        ahead, sideways = turn @ (self.obstacles - (x, y)).T
        out_of_view = np.abs(np.arctan2(sideways, ahead - CAMERA_AHEAD)) > self._half_view
        kept = out_of_view & (self._ages < memory)
        self.obstacles = np.vstack((self.obstacles[kept], (x, y) + self.ahead @ turn))
        self._ages = np.concatenate((self._ages[kept] + CONTROL_PERIOD, np.zeros(len(self.ahead))))

    def forget(self) -> None:
        """Forget all obstacles."""
        self.obstacles, self._ages = np.zeros((0, 2)), np.zeros(0)

    def _reckon(self, motion: Any) -> None:
        speed, _, turn_rate = np.asarray(motion, dtype=float)
        velocity = np.where(np.isfinite((speed, turn_rate)), (speed, turn_rate), self.velocity)
        if self._started:
            distance, turn = CONTROL_PERIOD * (velocity + self.velocity) / 2
            heading = self.pose[2] + turn / 2
            self.pose += (distance * math.cos(heading), distance * math.sin(heading), turn)
        self.velocity, self._started = velocity, True
