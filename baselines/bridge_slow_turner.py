"""Driver of a rover that hardly turns, as weak motors or a heavy load make it, for `bridge_mpc`.

Model predictive control finds local optima, and a rover that needs a second for six degrees is lost in most of them. So
this plans the turns of the whole way, every few control steps from where the rover is, and follows by pure pursuit, at
the speeds that the turns ahead allow.
"""

import numpy as np

from armctl.control.arc_path import ArcPath
from armctl.control.drive_limits import DriveLimits
from armctl.core.arrays import Array
from armctl.planning.turn_planner import TurnPlannerOptions, plan_turns
from armctl.robots.rover import RADIUS
from armctl.scene import BridgeMap
from armctl.tasks.bridge import CONTROL_PERIOD

REPLAN_STEPS = 5
"""Control steps between two plans."""
MARGINS = (0.03, 0.01)
"""m: distances between the rover and obstacles, the largest with which there is a path."""
MAX_SPEED, ACCELERATION = 1.6, 1.0
"""m/s, m/s^2: with all their force for acceleration, the wheels would have none for turns."""
TURN_SHARE = 0.9
"""Share of the largest turn rate that is planned with: it is less at speed."""
LOOK_AHEAD, FORESIGHT = 0.4, 2.0
"""m: point of the path that is pursued, and distance up to which turns limit the speed."""


class SlowTurner:
    """Crosses one bridge without people."""

    def __init__(self, goal_x: float) -> None:
        self._goal_x, self._steps = goal_x, 0
        self.path: ArcPath | None = None
        """The path to the goal line; None if there is none."""

    def act(self, bridge: BridgeMap, pose: Array, velocity: Array, limits: DriveLimits) -> tuple[float, float] | None:
        """Return linear (m/s) and angular velocity (rad/s) for a pose and velocities; None if there is no path."""
        max_turn_rate = TURN_SHARE * limits.max_turn_rate
        if self._steps % REPLAN_STEPS == 0:
            self.path = self._plan(bridge, pose, max_turn_rate)
        self._steps += 1
        if self.path is None:
            self._steps = 0
            return None
        arc = float(self.path.nearest(pose[:2], 0.0, FORESIGHT))
        ahead, sideways = self.path.points_at(arc + LOOK_AHEAD) - pose[:2]
        bearing = (np.arctan2(sideways, ahead) - pose[2] + np.pi) % (2 * np.pi) - np.pi
        curvature = 2 * np.sin(bearing) / max(float(np.hypot(ahead, sideways)), LOOK_AHEAD / 2)
        speed = min(
            self._speed(self.path, arc, max_turn_rate),
            max_turn_rate / max(abs(curvature), 1e-6),
            float(velocity[0]) + CONTROL_PERIOD * ACCELERATION,
        )
        return speed, float(np.clip(curvature * speed, -max_turn_rate, max_turn_rate))

    def _plan(self, bridge: BridgeMap, pose: Array, turn_rate: float) -> ArcPath | None:
        for margin in MARGINS:
            options = TurnPlannerOptions(speed=MAX_SPEED, turn_rate=turn_rate, clearance=RADIUS + margin)
            path, _ = plan_turns(bridge, pose, self._goal_x, options)
            if len(path):
                return ArcPath(path)
        return None

    def _speed(self, path: ArcPath, arc: float, turn_rate: float) -> float:
        """Return the speed (m/s) from which the rover can slow down for each turn ahead."""
        arcs = arc + np.arange(0.0, FORESIGHT, LOOK_AHEAD / 2)
        starts, corners, ends = (path.points_at(arcs + shift) for shift in (-LOOK_AHEAD / 2, 0.0, LOOK_AHEAD / 2))
        first, second = corners - starts, ends - corners
        cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        turn = np.abs(np.arctan2(cross, (first * second).sum(axis=1)))
        allowed = turn_rate * LOOK_AHEAD / np.maximum(turn, 1e-6)
        return float(min(MAX_SPEED, np.sqrt(allowed**2 + 2 * ACCELERATION * (arcs - arc)).min()))
