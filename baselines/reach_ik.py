"""The IK expert: moves to the configuration in the target sphere that the joints reach in minimum time.

It plans from the observation alone, and again whenever the arm should have arrived a while ago: by the clock, since
noisy readings never look at rest. Meanwhile it shifts its goal by what it reads: the mean of the observed targets, and
the offset of the observed tip from the model's, which is the links' error. For a moving target it plans at every
control step.
"""

import math

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.reach_task import checked_options
from armctl.core.arrays import Array
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel, MinimumTimeReach
from armctl.kinematics.damped_least_squares import damped_step
from armctl.policies import PerWorld, made_for, sees
from armctl.robot_description.joint_profiles import towards
from armctl.tasks import OBSERVATION, ReachMovingOptions, ReachOptions
from armctl.tasks.reach import CONTROL_PERIOD

MARGIN = 0.9
"""Fraction of the tolerance to aim at, as a reserve for servo errors."""
SMOOTHING = 0.1
"""Weight of the latest reading of the tip's offset: noise is averaged over about 20 readings, and the error of a model
whose links have other lengths, which depends on the configuration, is known within about 10."""
FARTHEST_AHEAD = 0.5
"""s: a moving target is thought to keep its velocity for so long at most."""
LAG = 0.05
"""s from an observation until the arm is where it is commanded to: a control step, and a little."""
DAMPING = 1e-4
"""m^2, of joint velocities near singularities."""
REPLAN_STEPS = 5
"""Control steps after the planned arrival until it plans again."""


@made_for("armctl/ArmReach*", controls="arms: not torque")
@sees("model", family="IK")
def make(env: ModelInterface) -> PerWorld:
    """Pinocchio IK: the minimum-time collision-free configuration that reaches the target."""
    controls = ("position", "relative", "delta", "velocity")
    options = checked_options("reach_ik", env, ReachOptions, "armctl/ArmReach-v0", OBSERVATION, controls)
    search = MinimumTimeReach(ArmModel(env.robot))
    make_one = ReachIkTracking if isinstance(options, ReachMovingOptions) else ReachIk
    return PerWorld([make_one(search, options.tolerance, options.control, CONTROL_PERIOD) for _ in range(env.num_envs)])


class ReachIk:
    """Reaches with one arm."""

    def __init__(self, search: MinimumTimeReach, tolerance: float, control: str, period: float) -> None:
        self._search, self._tolerance, self._control, self._period = search, tolerance, control, period
        self.reset()

    def reset(self) -> None:
        """Forget the plan and all readings."""
        self._readings = self._plans = self._steps_to_plan = 0
        self._target, self._tip_offset = np.zeros(3), np.zeros(3)

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return the action (dof,) for an observation: positions of end-effector, joints and target, and others."""
        model = self._search.model
        tip, q, target, _ = np.split(observation.astype(float), (3, 3 + model.dof, 6 + model.dof))
        self._readings += 1
        self._target += (target - self._target) / self._readings
        if self._steps_to_plan == 0:
            self._plan(q)
        self._steps_to_plan -= 1
        self._tip_offset += SMOOTHING * (tip - model.position(q) - self._tip_offset)
        shift = self._target - self._tip_offset - self._aim
        return self._towards(self._goal + damped_step(self._jacobian, shift, DAMPING), q)

    def _plan(self, q: Array) -> None:
        """Plan a motion from `q` (dof,) into a sphere that becomes smaller with each plan that did not suffice."""
        self._plans += 1
        self._aim = self._target - self._tip_offset
        goal = self._search.find(q, self._aim, MARGIN * self._tolerance / self._plans)
        self._goal = self._search.ik.position(self._aim, q).closest if goal is None else goal.command
        self._jacobian = self._search.model.jacobian(self._goal)[:3]
        self._steps_to_plan = REPLAN_STEPS + (0 if goal is None else math.ceil(goal.time / self._period))

    def _towards(self, goal: Array, q: Array) -> Array:
        velocity = towards(goal, q, self._search.model.limits, self._period)
        actions = {"position": goal, "relative": goal - q, "delta": velocity * self._period, "velocity": velocity}
        return actions[self._control]


class ReachIkTracking(ReachIk):
    """Tracks a moving target: goes to where it will be on arrival, and within the tolerance moves along with it.

    It remembers nothing: each action follows from the present observation.
    """

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return the action (dof,) for an observation, whose last part is the target's velocity, m/s."""
        dof = self._search.model.dof
        tip, q, target, velocity = np.split(observation.astype(float), (3, 3 + dof, 6 + dof))
        if np.linalg.norm(tip - target) > self._tolerance and (goal := self._meet(q, target, velocity)) is not None:
            return self._towards(goal, q)
        return self._towards(self._along(q, target, velocity), q)

    def _meet(self, q: Array, target: Array, velocity: Array) -> Array | None:
        """Return the command with which the arm reaches the target as early as possible; None if none was found."""
        radius = MARGIN * self._tolerance
        goal = self._search.find(q, target, radius)
        if goal is None:
            return None
        later_goal = self._search.find(q, target + min(goal.time, FARTHEST_AHEAD) * velocity, radius)
        return (later_goal or goal).command

    def _along(self, q: Array, target: Array, velocity: Array) -> Array:
        """Return the command with which the joints pass the target's next position at its velocity.

        Drives stop at what is commanded, and so it is farther by their braking distances.
        """
        model = self._search.model
        goal = self._search.ik.position(target + LAG * velocity, q).closest
        speeds = damped_step(model.jacobian(goal)[:3], velocity, DAMPING)
        return np.asarray(goal + speeds * np.abs(speeds) / (2 * model.limits.acceleration))
