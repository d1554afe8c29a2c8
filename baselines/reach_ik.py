"""The IK expert: moves to the configuration in the target sphere that the joints reach in minimum time.

It plans from the observation alone, and again whenever the arm should have arrived a while ago: by the clock, since
noisy readings never look at rest. Meanwhile it shifts its goal by what it reads: the mean of the observed targets, and
the offset of the observed tip from the model's, which is the links' error. For a moving target it plans at every
control step.
"""

import functools
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armctl.baselines.reach_task import checked_options, search_for, split
from armctl.core.arrays import Array
from armctl.core.options import changed_options, options
from armctl.envs import ModelInterface
from armctl.estimation.arm_observer import ArmObserver
from armctl.kinematics import ArmModel, MinimumTimeReach
from armctl.kinematics.damped_least_squares import damped_step
from armctl.kinematics.room import ROOM, TRACKING_DAMPING, moved_along, with_room
from armctl.policies import PerWorld, made_for, sees
from armctl.robot_description.joint_profiles import towards
from armctl.tasks import OBSERVATION, ReachMovingOptions, ReachOptions
from armctl.tasks.reach import CONTROL_PERIOD

SMOOTHING = 0.1
"""Weight of the latest reading of the tip's offset: noise is averaged over about 20 readings, and the error of a model
whose links have other lengths, which depends on the configuration, is known within about 10."""
FARTHEST_AHEAD = 0.5
"""s: a moving target is thought to keep its velocity for so long at most."""
LAG = 0.05
"""s from an observation until the arm is where it is commanded to: a control step, and a little."""
DAMPING = 1e-4
"""m^2, of joint velocities near singularities."""
LARGEST_CORRECTION = 0.2
"""rad, of a plan in a control step."""
REPLAN_STEPS = 5
"""Control steps after the planned arrival until it plans again."""


@options
class ReachIkOptions:
    """Options of the expert."""

    margin: Annotated[float, Field(gt=0, le=1)] = 0.9
    """Fraction of the tolerance to aim at, as a reserve for servo errors."""
    prepared: bool = True
    """Estimate joints, links, load, target and delay, where positions are commanded. False: average some readings."""


@made_for("armctl/ArmReach* armctl/ArmPose-v0 armctl/ArmScenes-v0", controls="arms: not torque")
@sees("model", family="IK")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> PerWorld:
    """Pinocchio IK: the minimum-time collision-free configuration that reaches the target."""
    controls = ("position", "relative", "delta", "velocity")
    task = checked_options("reach_ik", env, ReachOptions, "armctl/ArmReach-v0", OBSERVATION, controls, poses=True)
    search = search_for(ArmModel(env.robot), task)
    chosen = changed_options(ReachIkOptions(), options, "option of reach_ik")
    moving, prepared = isinstance(task, ReachMovingOptions), chosen.prepared and task.control == "position"
    setting = search, task.tolerance, chosen.margin * task.tolerance
    if not prepared:
        unprepared = ReachIkTracking if moving else ReachIk
        return PerWorld([unprepared(*setting, task.control) for _ in range(env.num_envs)])
    expert = PreparedReachIkTracking if moving else PreparedReachIk
    clocks = (functools.partial(env.control_step, i) for i in range(env.num_envs))
    observers = (ArmObserver(search.model, CONTROL_PERIOD, moving, clock) for clock in clocks)
    return PerWorld([expert(*setting, observer) for observer in observers], prepared=True)


class ReachIk:
    """Reaches with one arm."""

    def __init__(self, search: MinimumTimeReach, tolerance: float, radius: float, control: str) -> None:
        self._search, self._tolerance, self._radius, self._control = search, tolerance, radius, control
        self.reset()

    def reset(self) -> None:
        """Forget the plan and all readings."""
        self._readings = self._plans = self._steps_to_plan = 0
        self._target, self._tip_offset = np.zeros((2, len(self._search.place(self._search.model.home))))

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return the action (dof,) for an observation: positions of end-effector, joints and target, and others."""
        tip, q, target, _ = split(self._search, observation)
        self._readings += 1
        self._target += (target - self._target) / self._readings
        if self._steps_to_plan == 0:
            self._plan(q)
        self._steps_to_plan -= 1
        self._tip_offset += SMOOTHING * (tip - self._search.place(q) - self._tip_offset)
        shift = self._target - self._tip_offset - self._aim
        return self._towards(self._goal + damped_step(self._jacobian, shift, DAMPING), q)

    def _plan(self, q: Array) -> None:
        """Plan a motion from `q` (dof,) into a sphere that becomes smaller with each plan that did not suffice."""
        self._plans += 1
        self._aim = self._target - self._tip_offset
        goal = self._search.find(q, self._aim, self._radius / self._plans)
        self._entry = self._search.closest(self._aim, q) if goal is None else goal.q
        self._goal = self._entry if goal is None else goal.command
        self._jacobian = self._search.place_jacobian(self._goal)
        self._steps_to_plan = REPLAN_STEPS + (0 if goal is None else math.ceil(goal.time / CONTROL_PERIOD))

    def _towards(self, goal: Array, q: Array) -> Array:
        velocity = towards(goal, q, self._search.model.limits, CONTROL_PERIOD)
        actions = {"position": goal, "relative": goal - q, "delta": velocity * CONTROL_PERIOD, "velocity": velocity}
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
        radius = self._radius
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


class PreparedReachIk(ReachIk):
    """Reaches with one arm by estimates instead of readings, and shifts its commands by what a load takes away."""

    def __init__(self, search: MinimumTimeReach, tolerance: float, radius: float, belief: ArmObserver) -> None:
        self._belief = belief
        super().__init__(search, tolerance, radius, "position")

    def reset(self) -> None:
        """Forget the plan and all readings."""
        super().reset()
        self._belief.reset()

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation: end-effector, joints, target, and others."""
        belief = self._belief
        tip, q, target, _ = split(self._search, observation)
        belief.read(tip[:3], q, target[:3])
        self._readings += 1
        self._target += (target - self._target) / self._readings
        self._target[:3] = belief.target
        if self._steps_to_plan == 0:
            self._plan(belief.joints_ahead)
            self._inside = self._search.place(self._entry) - self._aim
        self._steps_to_plan -= 1
        self._correct()
        command = self._goal - belief.load_offset
        belief.send(command)
        return np.asarray(command)

    def _correct(self) -> None:
        """Make a Newton step to the planned place in the sphere, by what is known of links and target by now."""
        self._tip_offset[:3] = self._belief.tip_offset(self._entry)
        error = self._target + self._inside - self._search.place(self._entry) - self._tip_offset
        step = damped_step(self._search.place_jacobian(self._entry), error, DAMPING)
        step *= LARGEST_CORRECTION / max(float(np.abs(step).max()), LARGEST_CORRECTION)
        self._entry, self._goal = self._entry + step, self._goal + step


class PreparedReachIkTracking(ReachIkTracking):
    """Tracks a moving target by estimates: meets it in a posture with room around, which is kept while that goes well.

    Drives that stop where the target will be on arrival do not overshoot it.
    """

    def __init__(self, search: MinimumTimeReach, tolerance: float, radius: float, belief: ArmObserver) -> None:
        self._belief = belief
        super().__init__(search, tolerance, radius, "position")

    def reset(self) -> None:
        """Forget the posture and all readings."""
        super().reset()
        self._belief.reset()
        self._posture: Array | None = None
        self._patience = 0

    def act(self, observation: NDArray[np.float32]) -> Array:
        """Return joint positions (dof,) to move to, for an observation, which has the target's velocity."""
        belief, model = self._belief, self._search.model
        belief.read(*np.split(observation.astype(float), (3, 3 + model.dof, 6 + model.dof, 9 + model.dof))[:4])
        start = belief.commanded
        if self._is_lost():
            self._choose(start)
        assert self._posture is not None
        ahead = float(np.clip(model.min_time(start, self._posture), LAG, FARTHEST_AHEAD))
        meeting = belief.target_ahead(ahead)
        self._posture = moved_along(model, self._posture, meeting - belief.tip_offset(self._posture), CONTROL_PERIOD)
        speeds = damped_step(model.jacobian(self._posture)[:3], belief.target_velocity_ahead(), TRACKING_DAMPING)
        command = self._posture + speeds * np.abs(speeds) / (2 * model.limits.acceleration) - belief.load_offset
        belief.send(command)
        return np.asarray(command)

    def _is_lost(self) -> bool:
        """Return True without a posture, or if it is in collision or has not brought the arm to the target in time."""
        self._patience -= 1
        inside = float(np.linalg.norm(self._belief.tip - self._belief.target)) < self._tolerance
        if inside:
            self._patience = max(self._patience, REPLAN_STEPS)
        if self._posture is None or self._patience < 0:
            return True
        return not inside and self._patience < REPLAN_STEPS and not self._search.model.is_free(self._posture)

    def _choose(self, start: Array) -> None:
        """Choose a posture in which to meet the target, from `start` (dof,), and how long to wait for that."""
        model, target = self._search.model, self._belief.target_ahead(LAG)
        offset = 0.0 if self._posture is None else self._belief.tip_offset(self._posture)
        posture = with_room(self._search.ik, target - offset, start, ROOM)
        self._posture = self._search.ik.position(target - offset, start).closest if posture is None else posture
        time = float(model.min_time(start, self._posture))
        self._patience = math.ceil(time / CONTROL_PERIOD) + self._belief.delay + 2 * REPLAN_STEPS
