"""The OMPL expert among obstacles: a planned path, timed to run smoothly within the joint limits, and followed.

It plans once an episode, from the observation alone, which tells the boxes. Where it comes to the end and has not
reached the target, it plans again.
"""

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armctl.control.streaming import CommandStream, commanded
from armctl.control.trajectory import Trajectory, smooth
from armctl.envs import TaskVectorEnv
from armctl.errors import ConfigurationError
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker
from armctl.planning import ArmPlanner
from armctl.policies import PerWorld
from armctl.scene import Boxes
from armctl.tasks import ReachObstaclesTask
from armctl.tasks.reach import read_boxes
from armctl.tasks.reach.obstacles import OBSTACLES_OBSERVATION

Array = NDArray[np.float64]

CLEARANCE = 0.005
"""m that the motion commanded keeps: half of what the path does, for corners are cut; servos are off by a few mm."""
TICKS_CHECKED = 2
"""Of the drives, between places whose connections are checked."""
HEADROOM = 0.7
"""Of the acceleration limits, for the trajectory: the drives need the rest to follow it."""


def make(env: TaskVectorEnv) -> PerWorld:
    """OMPL path around the obstacles, timed within velocity, acceleration and jerk limits, and followed."""
    if not isinstance(env.task, ReachObstaclesTask):
        raise ConfigurationError("reach_ompl reaches around obstacles: use it with armctl/ArmReachObstacles-v0")
    options, arm = env.task.options, env.task.arm
    if list(options.observation)[: len(OBSTACLES_OBSERVATION)] != list(OBSTACLES_OBSERVATION):
        expected = ", ".join(OBSTACLES_OBSERVATION)
        raise ConfigurationError(f"reach_ompl reads the observation {expected}; here it is another")
    if options.control != "position":
        raise ConfigurationError("reach_ompl commands joint positions: use control 'position'")
    planner = ArmPlanner(ArmModel(arm.description))
    return PerWorld([ReachOmpl(planner, options.tolerance, arm.period) for _ in range(env.num_envs)])


class ReachOmpl:
    """Reaches with one arm."""

    def __init__(self, planner: ArmPlanner, tolerance: float, period: float) -> None:
        self._planner, self._model, self._tolerance, self._period = planner, planner.model, tolerance, period
        self._shapes = ArmShapes(planner.model)
        self.reset()

    def reset(self) -> None:
        """Forget the plan."""
        self._motion: Trajectory | None = None
        self._decision = 0

    def plans(self) -> dict[str, Array]:
        """The end-effector's way, (m, 3) m, a point for each decision."""
        if self._motion is None:
            return {}
        times = np.arange(0.0, self._motion.duration + self._period, self._period)
        return {"path": self._model.positions(self._motion.at(times))}

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Joint positions (dof,) to move to, for an observation (6 + dof + boxes,)."""
        dof = self._model.dof
        _, q, target, boxes = np.split(observation.astype(float), (3, 3 + dof, 6 + dof))
        if self._motion is None or self._decision * self._period > self._motion.duration + 0.2:
            self._motion, self._decision = self._plan(q, target, read_boxes(boxes)), 0
            self._stream = CommandStream(self._model.limits, self._period, q)
        self._decision += 1
        return self._stream.goal_towards(self._motion.at(self._decision * self._period))

    def _plan(self, q: Array, target: Array, boxes: Boxes) -> Trajectory:
        """The timed motion; standing still if there is no way."""
        limits = self._model.limits
        start = np.clip(q, limits.lower, limits.upper)
        path = self._planner.plan(start, target, self._tolerance, boxes).path
        if len(path) < 2:
            return Trajectory(start[None])
        motions = EdgeChecker(self._shapes, boxes, CLEARANCE, start)

        def is_free(motion: Trajectory) -> bool:
            places = commanded(limits, motion, self._period)
            return all(motions.is_edge_free(a, b) for a, b in itertools.pairwise(places[::TICKS_CHECKED]))

        return smooth(replace(limits, acceleration=HEADROOM * limits.acceleration), path, is_free)
