"""The OMPL expert among obstacles: plans a path, times it within the joint limits, and follows it.

It plans once per episode, from the observation alone, which includes the boxes. If it ends without reaching the target,
it plans again.
"""

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.reach_task import checked_options
from armctl.control.streaming import CommandStream, commanded
from armctl.control.trajectory import Trajectory, smooth
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker
from armctl.planning import ArmPlanner
from armctl.policies import PerWorld, sees
from armctl.scene import Boxes
from armctl.tasks import ReachObstaclesOptions
from armctl.tasks.reach import CONTROL_PERIOD, read_boxes
from armctl.tasks.reach.obstacles import OBSTACLES_OBSERVATION

Array = NDArray[np.float64]

CLEARANCE = 0.005
"""m: clearance of the commanded motion. It is half the path's, since corners are cut; servos are off by a few mm."""
TICKS_CHECKED = 2
"""Ticks of the drives between configurations whose edges are checked."""
HEADROOM = 0.7
"""Fraction of the acceleration limits for the trajectory: the drives need the rest to follow it."""


@sees("model")
def make(env: ModelInterface) -> PerWorld:
    """OMPL path around the obstacles, timed within velocity, acceleration and jerk limits."""
    env_id = "armctl/ArmReachObstacles-v0"
    options = checked_options("reach_ompl", env, ReachObstaclesOptions, env_id, OBSTACLES_OBSERVATION, ["position"])
    planner = ArmPlanner(ArmModel(env.robot))
    return PerWorld([ReachOmpl(planner, options.tolerance, CONTROL_PERIOD) for _ in range(env.num_envs)])


class ReachOmpl:
    """Reaches with one arm."""

    def __init__(self, planner: ArmPlanner, tolerance: float, period: float) -> None:
        self._planner, self._model, self._tolerance, self._period = planner, planner.model, tolerance, period
        self._shapes = ArmShapes(planner.model)
        self.reset()

    def reset(self) -> None:
        """Forget the plan."""
        self._motion: Trajectory | None = None
        self._step = 0

    def plans(self) -> dict[str, Array]:
        """The end-effector's path, (m, 3) m, with a point for each control step."""
        if self._motion is None:
            return {}
        times = np.arange(0.0, self._motion.duration + self._period, self._period)
        return {"path": self._model.positions(self._motion.at(times))}

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Joint positions (dof,) to move to, for an observation (6 + dof + boxes,)."""
        dof = self._model.dof
        _, q, target, boxes = np.split(observation.astype(float), (3, 3 + dof, 6 + dof))
        if self._motion is None or self._step * self._period > self._motion.duration + 0.2:
            self._motion, self._step = self._plan(q, target, read_boxes(boxes)), 0
            self._stream = CommandStream(self._model.limits, self._period, q)
        self._step += 1
        return self._stream.goal_towards(self._motion.at(self._step * self._period))

    def _plan(self, q: Array, target: Array, boxes: Boxes) -> Trajectory:
        """The timed motion; at rest if there is no path."""
        limits = self._model.limits
        start = np.clip(q, limits.lower, limits.upper)
        path = self._planner.plan(start, target, self._tolerance, boxes).path
        if len(path) < 2:
            return Trajectory(start[None])
        edges = EdgeChecker(self._shapes, boxes, CLEARANCE, start)

        def is_free(motion: Trajectory) -> bool:
            positions = commanded(limits, motion, self._period)
            return all(edges.is_edge_free(a, b) for a, b in itertools.pairwise(positions[::TICKS_CHECKED]))

        return smooth(replace(limits, acceleration=HEADROOM * limits.acceleration), path, is_free)
