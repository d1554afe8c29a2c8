"""The IK expert: moves to the configuration in the target sphere that the joints reach in minimum time.

It plans once per episode, from the observation alone, and again if the arm stops elsewhere. After a moving target it
plans at every control step.
"""

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.reach_task import checked_options
from armctl.envs import ModelInterface
from armctl.kinematics import ArmModel, MinimumTimeReach
from armctl.kinematics.damped_least_squares import damped_step
from armctl.policies import PerWorld, sees
from armctl.robot_description.joint_profiles import towards
from armctl.tasks import OBSERVATION, ReachMovingOptions, ReachOptions
from armctl.tasks.reach import CONTROL_PERIOD

Array = NDArray[np.float64]

MARGIN = 0.9
"""Fraction of the tolerance to aim at, as a reserve for servo errors."""
STANDSTILL = 1e-3
"""rad: joint motion per control step below which the arm is at rest."""
FARTHEST_AHEAD = 0.5
"""s: a moving target is thought to keep its velocity for so long at most."""
LAG = 0.05
"""s from an observation until the arm is where it is commanded to: a control step, and a little."""
DAMPING = 1e-4
"""m^2, of joint velocities near singularities."""
PATIENCE = 5
"""Control steps at rest after which it plans again."""


@sees("model")
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
        """Forget the plan."""
        self._goal: Array | None = None
        self._last: Array | None = None
        self._still = 0

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Action (dof,) for an observation: end-effector position, joint positions, target position, and others."""
        dof = self._search.model.dof
        q, target = observation[3 : 3 + dof].astype(float), observation[3 + dof : 6 + dof].astype(float)
        return self._towards(self._next_goal(q, target), q)

    def _next_goal(self, q: Array, target: Array) -> Array:
        moved = self._last is None or np.abs(q - self._last).max() > STANDSTILL
        self._still = 0 if moved else self._still + 1
        if self._goal is None or self._still == PATIENCE:
            self._goal, self._still = self._plan(q, target), 0
        self._last = q
        return self._goal

    def _plan(self, q: Array, target: Array) -> Array:
        goal = self._search.find(q, target, MARGIN * self._tolerance)
        return self._search.ik.position(target, q).closest if goal is None else goal.command

    def _towards(self, goal: Array, q: Array) -> Array:
        velocity = towards(goal, q, self._search.model.limits, self._period)
        actions = {"position": goal, "relative": goal - q, "delta": velocity * self._period, "velocity": velocity}
        return actions[self._control]


class ReachIkTracking(ReachIk):
    """Tracks a moving target: goes to where it will be on arrival, and within the tolerance moves along with it.

    It remembers nothing: each action follows from the present observation.
    """

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Action (dof,) for an observation, whose last part is the target's velocity, m/s."""
        dof = self._search.model.dof
        tip, q, target, velocity = np.split(observation.astype(float), (3, 3 + dof, 6 + dof))
        if np.linalg.norm(tip - target) > self._tolerance and (goal := self._meet(q, target, velocity)) is not None:
            return self._towards(goal, q)
        return self._towards(self._along(q, target, velocity), q)

    def _meet(self, q: Array, target: Array, velocity: Array) -> Array | None:
        """The command with which the arm reaches the target as early as possible; None if none was found."""
        radius = MARGIN * self._tolerance
        now = self._search.find(q, target, radius)
        if now is None:
            return None
        then = self._search.find(q, target + min(now.time, FARTHEST_AHEAD) * velocity, radius)
        return (then or now).command

    def _along(self, q: Array, target: Array, velocity: Array) -> Array:
        """The command with which the joints pass the target's next position at its velocity.

        Drives stop at what is commanded, and so it is farther by their braking distances.
        """
        model = self._search.model
        goal = self._search.ik.position(target + LAG * velocity, q).closest
        speeds = damped_step(model.jacobian(goal)[:3], velocity, DAMPING)
        return np.asarray(goal + speeds * np.abs(speeds) / (2 * model.limits.acceleration))
