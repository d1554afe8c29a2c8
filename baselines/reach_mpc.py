"""The MPC expert: receding-horizon control of the arm's joints, with the target's motion predicted.

A posture is looked up once an episode, among many that the arm can take, for the optimisation is a local one. From then
on each decision is a plan of 0.8 s, of which the first period is commanded. It sees the observation alone, and where
there are boxes, these.
"""

import numpy as np
from numpy.typing import NDArray

from armctl.control.reach_mpc import ReachMpc, ReachMpcOptions
from armctl.control.reach_problem import JointTrajectory
from armctl.control.streaming import CommandStream
from armctl.envs import TaskVectorEnv
from armctl.errors import ConfigurationError
from armctl.kinematics import ArmModel, ReachabilityMap
from armctl.policies import PerWorld
from armctl.tasks import OBSERVATION, ReachTask
from armctl.tasks.reach import read_boxes

Array = NDArray[np.float64]

PATIENCE, HEADWAY = 12, 0.005
"""Decisions without the tip having come so many m nearer to the target, after which the arm goes to a posture first."""
THERE = 0.02
"""rad from a posture, where the arm has come to it."""
MARGIN, INFLUENCE = 0.01, 0.06
"""m from floor and itself that are kept, and from which on these are minded. Among boxes it is more."""


def make(env: TaskVectorEnv) -> PerWorld:
    """MPC with OSQP on Pinocchio's kinematics: joint limits kept, motion of the target predicted."""
    if not isinstance(env.task, ReachTask):
        raise ConfigurationError("reach_mpc moves arms: use it with armctl/ArmReach-v0")
    options, arm = env.task.options, env.task.arm
    if list(options.observation)[: len(OBSERVATION)] != list(OBSERVATION):
        raise ConfigurationError(f"reach_mpc reads the observation {', '.join(OBSERVATION)}; here it is another")
    if options.control != "position":
        raise ConfigurationError("reach_mpc commands joint positions: use control 'position'")
    postures = ReachabilityMap(ArmModel(arm.description))
    return PerWorld([ReachWithMpc(postures, options.tolerance, list(options.observation)) for _ in range(env.num_envs)])


class ReachWithMpc:
    """Reaches with one arm, for an observation of these parts, in order."""

    def __init__(self, postures: ReachabilityMap, tolerance: float, parts: list[str]) -> None:
        self._model, self._postures, self._tolerance = postures.model, postures, tolerance
        self._moving, self._boxed = "target_velocity" in parts, "boxes" in parts
        self.mpc = ReachMpc(self._model, ReachMpcOptions(margin=MARGIN, influence_distance=INFLUENCE))
        self._ahead = self.mpc.problem.period * np.arange(1, self.mpc.problem.horizon + 1)[:, None]
        self._failed_before = 0

    @property
    def failures(self) -> int:
        """Decisions without a solution, in which the arm braked."""
        return self._failed_before + self.mpc.failures

    def reset(self) -> None:
        """Forget the plan."""
        self.mpc.reset()
        self._posture: Array | None = None
        self._stream: CommandStream | None = None
        self._plan: JointTrajectory | None = None
        self._target_velocity: Array | None = None
        self._nearest, self._waited = np.inf, 0

    def plans(self) -> dict[str, Array]:
        """Where the end-effector is to be at the end of each period of the horizon, (N + 1, 3) m."""
        return {} if self._plan is None else {"horizon": self._model.positions(self._plan.positions)}

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Joint positions (dof,) to move to, for an observation (6 + dof + k,)."""
        dof = self._model.dof
        tip, q, target, extra = np.split(observation.astype(float), (3, 3 + dof, 6 + dof))
        distance = float(np.linalg.norm(tip - target))
        if self._posture is None:
            return self._first_goal(q, target, extra)
        if self._gives_up(distance):
            self._posture, self._stream = self._postures.towards(target, q, self.mpc.model), None
            self._plan = None
        if self._stream is None:
            if np.abs(q - self._posture).max() > THERE:
                return self._posture
            self._stream = CommandStream(self._model.limits, self.mpc.problem.period, self._posture)
            self.mpc.reset()
        posture = None if distance < self._tolerance else self._posture
        course = self._course(target, extra[:3]) if self._moving else target
        self._plan = self.mpc.plan(self._stream.position, self._stream.velocity, course, posture)
        return self._stream.goal(self._plan)

    def _first_goal(self, q: Array, target: Array, extra: Array) -> Array:
        """The way to a posture is begun before there is a plan: to look one up takes its time."""
        if self._boxed:
            self._failed_before = self.failures
            self.mpc = ReachMpc(self._model.among(read_boxes(extra)))
        self._posture = self._postures.towards(target, q, self.mpc.model)
        self._stream = CommandStream(self._model.limits, self.mpc.problem.period, q)
        self._plan = self.mpc.begin(q, np.zeros_like(q), self._posture)
        return self._stream.goal(self._plan)

    def _gives_up(self, distance: float) -> bool:
        """Whether the tip has long been away from the target without coming nearer, where a detour is open."""
        if distance < self._nearest - HEADWAY:
            self._nearest, self._waited = distance, 0
        self._waited += 1
        if distance < self._tolerance or self._waited <= PATIENCE or self._stream is None or self._boxed:
            return False
        self._nearest, self._waited = np.inf, 0
        return True

    def _course(self, target: Array, velocity: Array) -> Array:
        """Where the target will be, (N, 3), if its acceleration stays as it was since the last decision."""
        last = velocity if self._target_velocity is None else self._target_velocity
        acceleration = (velocity - last) / self.mpc.problem.period
        self._target_velocity = velocity
        return target + self._ahead * velocity + self._ahead**2 / 2 * acceleration
